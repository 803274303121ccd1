/* BDF 1, exponent 0.5, step 0.25: tolerance 1e-7. The exponentials in blocks of four decays and four coefficients, as fvi.h takes them. A memory on it ends after 1000000 samples, 250000 units of time:
   it refuses further ones, or forgets with FVI_FORGET_PAST_HORIZON. */
#define HALF_DERIVATIVE_HEAD 5
#define HALF_DERIVATIVE_EXPONENTIALS 72
#define HALF_DERIVATIVE_SLOW_BLOCKS 6
#define HALF_DERIVATIVE_FAR_BLOCKS 0
#define HALF_DERIVATIVE_HORIZON UINT64_C(1000000)
#define HALF_DERIVATIVE_STEP 2.5e-1
#define HALF_DERIVATIVE_NUMBERS(channels) \
    FVI_EXPONENTIAL_NUMBERS(HALF_DERIVATIVE_HEAD, HALF_DERIVATIVE_EXPONENTIALS, HALF_DERIVATIVE_FAR_BLOCKS, channels)
static const float half_derivative_head[HALF_DERIVATIVE_HEAD] = {
    2e0f, -1e0f, -2.5e-1f, -1.25e-1f,
    -7.8125e-2f,
};
static const float half_derivative_exponentials[HALF_DERIVATIVE_EXPONENTIALS] = {
    1.8425213e-7f, 7.017985e-7f, 1.4632271e-6f, 2.459017e-6f,
    -9.9077795e-11f, -3.4977937e-10f, -6.6220157e-10f, -1.1758295e-9f,
    3.9356974e-6f, 6.277239e-6f, 1.0011254e-5f, 1.5966407e-5f,
    -2.321626e-9f, -4.6734496e-9f, -9.412574e-9f, -1.8957229e-8f,
    2.5463869e-5f, 4.0610576e-5f, 6.476643e-5f, 1.0328911e-4f,
    -3.817966e-8f, -7.689083e-8f, -1.548437e-7f, -3.1179928e-7f,
    1.6472107e-4f, 2.6268055e-4f, 4.1887202e-4f, 6.678739e-4f,
    -6.2776485e-7f, -1.2636408e-6f, -2.5427196e-6f, -5.113653e-6f,
    1.0647393e-3f, 1.6970303e-3f, 2.7037885e-3f, 4.305227e-3f,
    -1.0274914e-5f, -2.0616277e-5f, -4.1272717e-5f, -8.2329854e-5f,
    6.8486757e-3f, 1.0878329e-2f, 1.7237816e-2f, 2.7212782e-2f,
    -1.6329561e-4f, -3.2096836e-4f, -6.2192284e-4f, -1.1782433e-3f,
    4.2709094e-2f, 6.642719e-2f, 1.0191465e-1f, 1.5324852e-1f,
    -2.1551298e-3f, -3.734057e-3f, -5.9604547e-3f, -8.433183e-3f,
    2.2399013e-1f, 3.1523007e-1f, 4.2335954e-1f, 5.393649e-1f,
    -1.0063317e-2f, -9.569467e-3f, -6.8727764e-3f, -3.5968805e-3f,
    6.516316e-1f, 7.5796795e-1f, 8.700808e-1f, 0e0f,
    -1.3815952e-3f, -4.181829e-4f, -5.336543e-5f, 0e0f,
};
/* The members of FviMemory that the table gives; the kind may be or-ed with flags, and the buffer has
   HALF_DERIVATIVE_NUMBERS(channels) numbers. */
#define HALF_DERIVATIVE_TABLE \
    .kind = FVI_EXPONENTIAL_SUM, .scale = 1.0f, .weights = half_derivative_head, .weight_count = HALF_DERIVATIVE_HEAD, \
    .exponentials = half_derivative_exponentials, .exponential_count = HALF_DERIVATIVE_EXPONENTIALS, .slow_blocks = HALF_DERIVATIVE_SLOW_BLOCKS, \
    .far_blocks = HALF_DERIVATIVE_FAR_BLOCKS, .horizon = HALF_DERIVATIVE_HORIZON, .step_size = HALF_DERIVATIVE_STEP
