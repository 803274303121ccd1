/* BDF 1, exponent -0.8, step 1: tolerance 1e-7. The exponentials in blocks of four decays and four coefficients, as fvi.h takes them. */
#define ENDLESS_INTEGRAL_HEAD 5
#define ENDLESS_INTEGRAL_EXPONENTIALS 128
#define ENDLESS_INTEGRAL_SLOW_BLOCKS 14
#define ENDLESS_INTEGRAL_FAR_BLOCKS 7
#define ENDLESS_INTEGRAL_HORIZON FVI_ENDLESS
#define ENDLESS_INTEGRAL_STEP 1e0
#define ENDLESS_INTEGRAL_NUMBERS(channels) \
    FVI_EXPONENTIAL_NUMBERS(ENDLESS_INTEGRAL_HEAD, ENDLESS_INTEGRAL_EXPONENTIALS, ENDLESS_INTEGRAL_FAR_BLOCKS, channels)
static const float endless_integral_head[ENDLESS_INTEGRAL_HEAD] = {
    1e0f, 8e-1f, 7.2e-1f, 6.72e-1f,
    6.384e-1f,
};
static const float endless_integral_exponentials[ENDLESS_INTEGRAL_EXPONENTIALS] = {
    2.2118724e-17f, 4.2541197e-16f, 1.2070206e-15f, 2.3703791e-15f,
    6.643211e-4f, 2.281588e-4f, 1.509854e-4f, 1.3804408e-4f,
    4.37208e-15f, 8.0407914e-15f, 1.4787623e-14f, 2.7195556e-14f,
    1.5314843e-4f, 1.729552e-4f, 1.9536795e-4f, 2.2068522e-4f,
    5.0014683e-14f, 9.1980785e-14f, 1.6915961e-13f, 3.110973e-13f,
    2.4928327e-4f, 2.815873e-4f, 3.1807754e-4f, 3.5929642e-4f,
    5.721315e-13f, 1.0521931e-12f, 1.9350626e-12f, 3.5587262e-12f,
    4.058568e-4f, 4.5845078e-4f, 5.1786035e-4f, 5.849686e-4f,
    6.5447665e-12f, 1.203632e-11f, 2.2135703e-11f, 4.070923e-11f,
    6.607733e-4f, 7.464013e-4f, 8.431257e-4f, 9.523843e-4f,
    7.486735e-11f, 1.3768672e-10f, 2.5321628e-10f, 4.656839e-10f,
    1.0758014e-3f, 1.215212e-3f, 1.3726884e-3f, 1.5505719e-3f,
    8.564279e-10f, 1.5750355e-9f, 2.8966094e-9f, 5.3270837e-9f,
    1.7515067e-3f, 1.9784803e-3f, 2.2348666e-3f, 2.5244777e-3f,
    9.796909e-9f, 1.8017257e-8f, 3.3135095e-8f, 6.093794e-8f,
    2.8516187e-3f, 3.2211528e-3f, 3.638574e-3f, 4.110087e-3f,
    1.1206948e-7f, 2.0610423e-7f, 3.7904118e-7f, 6.9708517e-7f,
    4.642702e-3f, 5.244336e-3f, 5.9239306e-3f, 6.6915858e-3f,
    1.2819916e-6f, 2.3576767e-6f, 4.3359373e-6f, 7.974088e-6f,
    7.5587058e-3f, 8.538165e-3f, 9.644492e-3f, 1.089406e-2f,
    1.4664852e-5f, 2.6969437e-5f, 4.959771e-5f, 9.1210146e-5f,
    1.2305301e-2f, 1.38988895e-2f, 1.5697882e-2f, 1.7727705e-2f,
    1.6772952e-4f, 3.0842386e-4f, 5.67068e-4f, 1.042385e-3f,
    2.0015802e-2f, 2.259052e-2f, 2.5478384e-2f, 2.869804e-2f,
    1.9153495e-3f, 3.5168205e-3f, 6.4486694e-3f, 1.1795765e-2f,
    3.224735e-2f, 3.6076926e-2f, 4.0037915e-2f, 4.378545e-2f,
    2.1480696e-2f, 3.88052e-2f, 6.911527e-2f, 1.2014089e-1f,
    4.6621457e-2f, 4.731053e-2f, 4.409453e-2f, 3.5514686e-2f,
    2.0071468e-1f, 3.159233e-1f, 4.5926362e-1f, 6.1033255e-1f,
    2.2545515e-2f, 1.0009164e-2f, 2.7580524e-3f, 4.4607118e-4f,
    7.5949574e-1f, 0e0f, 0e0f, 0e0f,
    3.908273e-5f, 0e0f, 0e0f, 0e0f,
};
/* The members of FviMemory that the table gives; the kind may be or-ed with flags, and the buffer has
   ENDLESS_INTEGRAL_NUMBERS(channels) numbers. */
#define ENDLESS_INTEGRAL_TABLE \
    .kind = FVI_EXPONENTIAL_SUM, .scale = 1.0f, .weights = endless_integral_head, .weight_count = ENDLESS_INTEGRAL_HEAD, \
    .exponentials = endless_integral_exponentials, .exponential_count = ENDLESS_INTEGRAL_EXPONENTIALS, .slow_blocks = ENDLESS_INTEGRAL_SLOW_BLOCKS, \
    .far_blocks = ENDLESS_INTEGRAL_FAR_BLOCKS, .horizon = ENDLESS_INTEGRAL_HORIZON, .step_size = ENDLESS_INTEGRAL_STEP
