/* Part of streams.c, for a NUMBER; OF(name) and Of(Name) are the names of the interface for it. No include guard: it is included twice. */

static void OF(fill)(NUMBER *numbers, size_t count, double decay) {
    for (size_t i = 0; i < count; ++i) {
        numbers[i] = (NUMBER)((double)OF(noise)() * exp(-decay * (double)i));
    }
}

/* Sum over n of w(n) x(k - n), by its definition, with the first lag `latency`. */
static double OF(plain)(const NUMBER *w, size_t count, const NUMBER *x, size_t k, size_t latency) {
    double sum = 0.0;
    for (size_t n = 0; n < count && n + latency <= k; ++n) {
        sum += (double)w[n] * (double)x[k - latency - n];
    }
    return sum;
}

/* What rounding may change: a few units of the sum of |w|. */
static double OF(bound)(const NUMBER *w, size_t count) {
    double sum = 0.0;
    for (size_t n = 0; n < count; ++n) {
        sum += fabs((double)w[n]);
    }
    return 16.0 * UNIT * sum;
}

static Of(FviConvolver) *OF(made)(const Of(FviResponse) *responses, size_t inputs, size_t outputs, size_t latency, size_t block, size_t longest) {
    FviStream stream = {latency, block, longest};
    Of(FviConvolver) *convolver = NULL;
    expect("new", OF(fvi_convolver_new)(responses, inputs, outputs, &stream, &convolver), FVI_STREAM_STATUS_OK);
    return convolver;
}

static Of(FviPrepared) *OF(prepared)(const Of(FviPreparer) *preparer, const NUMBER *w, size_t count) {
    Of(FviResponse) response = {w, count};
    Of(FviPrepared) *prepared = NULL;
    expect("prepare", OF(fvi_preparer_prepare)(preparer, &response, 1, 1, &prepared), FVI_STREAM_STATUS_OK);
    return prepared;
}

/* Samples `from` to `to` of one channel, in calls of `call` samples. */
static void OF(run)(Of(FviConvolver) *convolver, const NUMBER *input, NUMBER *output, size_t from, size_t to, size_t call) {
    unsigned long long before = calls;
    int status = FVI_STREAM_STATUS_OK;
    for (size_t k = from; k < to && status == FVI_STREAM_STATUS_OK; k += call) {
        const NUMBER *const in = input + k;
        NUMBER *const out = output + k;
        status = OF(fvi_convolver_process)(convolver, &in, &out, to - k < call ? to - k : call);
    }
    expect_that("a block neither allocates nor enters the kernel", calls == before);
    expect("process", status, FVI_STREAM_STATUS_OK);
}

static NUMBER OF(w)[3][LENGTH], OF(x)[2][SAMPLES], OF(y)[3][SAMPLES];

/* Two inputs and three outputs, one pair of them without a response. */
static void OF(check_sums)(void) {
    OF(fill)(OF(w)[0], 3 * LENGTH, 1e-4);
    OF(fill)(OF(x)[0], 2 * SAMPLES, 0.0);
    Of(FviResponse) responses[6] = {{OF(w)[0], LENGTH}, {OF(w)[1], 17}, {OF(w)[2], 900}, {NULL, 0}, {OF(w)[0], 1}, {OF(w)[1], LENGTH}};
    static const size_t latencies[] = {0, 64, 5}, blocks[] = {0, 64, 256};
    for (size_t plan = 0; plan < 3; ++plan) {
        size_t latency = latencies[plan], block = blocks[plan];
        Of(FviConvolver) *convolver = OF(made)(responses, 2, 3, latency, block, 0);
        unsigned long long before = calls;
        for (size_t k = 0, call = 1; k < SAMPLES; k += call) {
            call = block ? block : (call * 7 + 3) % 311;
            call = SAMPLES - k < call ? SAMPLES - k : call;
            const NUMBER *inputs[] = {OF(x)[0] + k, OF(x)[1] + k};
            NUMBER *outputs[] = {OF(y)[0] + k, OF(y)[1] + k, OF(y)[2] + k};
            expect("process", OF(fvi_convolver_process)(convolver, inputs, outputs, call), FVI_STREAM_STATUS_OK);
        }
        expect_that("a block neither allocates nor enters the kernel", calls == before);
        double bound = OF(bound)(OF(w)[0], 3 * LENGTH);
        for (size_t k = 0; k < SAMPLES; k += 97) {
            for (size_t output = 0; output < 3; ++output) {
                const Of(FviResponse) *first = &responses[output], *second = &responses[3 + output];
                double sum = OF(plain)(first->samples, first->count, OF(x)[0], k, latency) + OF(plain)(second->samples, second->count, OF(x)[1], k, latency);
                expect_that("sum of two inputs", fabs((double)OF(y)[output][k] - sum) <= bound);
            }
        }
        FviConvolverFacts facts;
        expect("facts", OF(fvi_convolver_facts)(convolver, &facts), FVI_STREAM_STATUS_OK);
        expect_that("facts", facts.inputs == 2 && facts.outputs == 3 && facts.latency == latency && facts.longest == LENGTH);
        expect_that("place", facts.taken == SAMPLES && facts.exchange_left == 0 && facts.overruns == 0 && facts.bytes > LENGTH);
        OF(fvi_convolver_free)(convolver);
    }
}

/* Outputs in the arrays of the inputs; the same response for both channels is stored once. */
static void OF(check_in_place)(void) {
    Of(FviResponse) shared[4] = {{OF(w)[0], LENGTH}, {NULL, 0}, {NULL, 0}, {OF(w)[0], LENGTH}};
    Of(FviResponse) others[4] = {{OF(w)[0], LENGTH}, {NULL, 0}, {NULL, 0}, {OF(w)[1], LENGTH}};
    Of(FviConvolver) *apart = OF(made)(shared, 2, 2, 0, 128, 0), *within = OF(made)(shared, 2, 2, 0, 128, 0);
    Of(FviConvolver) *larger = OF(made)(others, 2, 2, 0, 128, 0);
    FviConvolverFacts facts, of_larger;
    expect("facts", OF(fvi_convolver_facts)(apart, &facts), FVI_STREAM_STATUS_OK);
    expect("facts", OF(fvi_convolver_facts)(larger, &of_larger), FVI_STREAM_STATUS_OK);
    expect_that("the same response is stored once", facts.bytes + LENGTH * sizeof(NUMBER) < of_larger.bytes);
    static NUMBER both[2][SAMPLES];
    memcpy(both, OF(x), sizeof both);
    for (size_t k = 0; k < SAMPLES; k += 1000) {
        const NUMBER *inputs[] = {OF(x)[0] + k, OF(x)[1] + k};
        NUMBER *outputs[] = {OF(y)[0] + k, OF(y)[1] + k};
        expect("apart", OF(fvi_convolver_process)(apart, inputs, outputs, 1000), FVI_STREAM_STATUS_OK);
        /* Channels change places as well. */
        const NUMBER *in[] = {both[0] + k, both[1] + k};
        NUMBER *out[] = {both[1] + k, both[0] + k};
        expect("in place", OF(fvi_convolver_process)(within, in, out, 1000), FVI_STREAM_STATUS_OK);
    }
    expect_that("in place", !memcmp(both[0], OF(y)[1], sizeof both[0]) && !memcmp(both[1], OF(y)[0], sizeof both[1]));
    expect("no samples", OF(fvi_convolver_process)(apart, (const NUMBER *const[]){NULL, NULL}, (NUMBER *const[]){NULL, NULL}, 0), FVI_STREAM_STATUS_OK);
    OF(fvi_convolver_free)(apart);
    OF(fvi_convolver_free)(within);
    OF(fvi_convolver_free)(larger);
}

/* The crossfade by its definition, at once and evenly; then what was in use before is exchanged for the new ones again. */
static void OF(check_exchange)(void) {
    enum { AT = 5001, FADE = 700 };
    for (int evenly = 0; evenly < 2; ++evenly) {
        Of(FviResponse) response = {OF(w)[0], LENGTH};
        Of(FviConvolver) *convolver = OF(made)(&response, 1, 1, 0, 0, 0);
        Of(FviPreparer) *preparer = NULL;
        expect("preparer", OF(fvi_preparer_new)(convolver, &preparer), FVI_STREAM_STATUS_OK);
        Of(FviPrepared) *place = OF(prepared)(preparer, OF(w)[1], 2500), *other = OF(prepared)(preparer, OF(w)[2], LENGTH);
        OF(run)(convolver, OF(x)[0], OF(y)[0], 0, AT, 64);
        unsigned long long before = calls;
        uint64_t begins_in = 7;
        expect("exchange", (evenly ? OF(fvi_convolver_exchange_evenly) : OF(fvi_convolver_exchange))(convolver, place, FADE, &begins_in), FVI_STREAM_STATUS_OK);
        expect_that("an exchange neither allocates nor enters the kernel", calls == before);
        expect_that("the fade begins", evenly ? begins_in > 0 && begins_in < 5000 : begins_in == 0);
        expect("twice", OF(fvi_convolver_exchange)(convolver, other, FADE, NULL), FVI_STREAM_STATUS_BUSY);
        expect("none yet", OF(fvi_convolver_take_retired)(convolver, place), FVI_STREAM_STATUS_EMPTY);
        OF(run)(convolver, OF(x)[0], OF(y)[0], AT, SAMPLES, 64);
        double bound = OF(bound)(OF(w)[0], LENGTH) + OF(bound)(OF(w)[1], LENGTH);
        for (size_t k = AT; k < SAMPLES; k += k < AT + begins_in + FADE ? 1 : 97) {
            double past = (double)k - (double)(AT + begins_in), share = past <= 0.0 ? 0.0 : past < FADE ? past / FADE : 1.0;
            double old = OF(plain)(OF(w)[0], LENGTH, OF(x)[0], k, 0), new = OF(plain)(OF(w)[1], 2500, OF(x)[0], k, 0);
            expect_that("crossfade", fabs((double)OF(y)[0][k] - (1.0 - share) * old - share * new) <= bound);
        }
        expect("occupied", OF(fvi_convolver_take_retired)(convolver, other), FVI_STREAM_STATUS_OCCUPIED);
        expect("nothing in it", OF(fvi_convolver_exchange)(convolver, place, 0, NULL), FVI_STREAM_STATUS_EMPTY);
        expect("take", OF(fvi_convolver_take_retired)(convolver, place), FVI_STREAM_STATUS_OK);
        /* With nothing taken, an exchange puts what is out of use in the place of the new ones. */
        expect("at once", OF(fvi_convolver_exchange)(convolver, place, 0, NULL), FVI_STREAM_STATUS_OK);
        expect("at once", OF(fvi_convolver_exchange)(convolver, other, 0, NULL), FVI_STREAM_STATUS_OK);
        expect("it came back", OF(fvi_convolver_take_retired)(convolver, other), FVI_STREAM_STATUS_OCCUPIED);
        expect("the first as well", OF(fvi_convolver_take_retired)(convolver, place), FVI_STREAM_STATUS_OK);
        /* The longest fade there can be. */
        expect("endless", OF(fvi_convolver_exchange)(convolver, place, SIZE_MAX, NULL), FVI_STREAM_STATUS_OK);
        FviConvolverFacts facts;
        expect("facts", OF(fvi_convolver_facts)(convolver, &facts), FVI_STREAM_STATUS_OK);
        expect_that("an endless fade", facts.exchange_left > UINT32_MAX);
        expect("clear", OF(fvi_convolver_clear)(convolver), FVI_STREAM_STATUS_OK);
        OF(run)(convolver, OF(x)[0], OF(y)[1], 0, 640, 64);
        expect_that("from the beginning", fabs((double)OF(y)[1][639] - OF(plain)(OF(w)[0], LENGTH, OF(x)[0], 639, 0)) <= bound
                                              || fabs((double)OF(y)[1][639] - OF(plain)(OF(w)[1], 2500, OF(x)[0], 639, 0)) <= bound);
        OF(fvi_prepared_free)(place);
        OF(fvi_prepared_free)(other);
        OF(fvi_preparer_free)(preparer);
        OF(fvi_convolver_free)(convolver);
    }
}

/* A saved state goes on with the same bits in another convolver; cut or of another one it is refused, and nothing has changed. */
static void OF(check_states)(void) {
    Of(FviResponse) response = {OF(w)[0], LENGTH}, other_response = {OF(w)[1], LENGTH};
    Of(FviConvolver) *convolver = OF(made)(&response, 1, 1, 0, 64, 0), *other = OF(made)(&response, 1, 1, 0, 64, 0);
    Of(FviConvolver) *foreign = OF(made)(&other_response, 1, 1, 0, 64, 0);
    OF(run)(convolver, OF(x)[0], OF(y)[0], 0, 6000, 64);
    OF(run)(other, OF(x)[1], OF(y)[1], 0, 777, 64);
    size_t size = 0, written = 0;
    expect("size", OF(fvi_convolver_save)(convolver, NULL, 0, &size), FVI_STREAM_STATUS_OK);
    unsigned char *bytes = malloc(size + 8);
    expect("small", OF(fvi_convolver_save)(convolver, bytes, size - 1, &written), FVI_STREAM_STATUS_WRONG_SIZE);
    expect_that("nothing written", written == 0);
    expect("save", OF(fvi_convolver_save)(convolver, bytes, size + 8, &written), FVI_STREAM_STATUS_OK);
    expect_that("as many as announced", written == size && size > LENGTH * sizeof(NUMBER));
    expect("foreign", OF(fvi_convolver_restore)(foreign, bytes, size), FVI_STREAM_STATUS_WRONG_STATE);
    expect("cut", OF(fvi_convolver_restore)(other, bytes, size - 1), FVI_STREAM_STATUS_WRONG_STATE);
    bytes[0] ^= 1;
    expect("no state", OF(fvi_convolver_restore)(other, bytes, size), FVI_STREAM_STATUS_WRONG_STATE);
    bytes[0] ^= 1;
    FviConvolverFacts facts;
    expect("facts", OF(fvi_convolver_facts)(other, &facts), FVI_STREAM_STATUS_OK);
    expect_that("a refused state changes nothing", facts.taken == 777);
    expect("restore", OF(fvi_convolver_restore)(other, bytes, size + 8), FVI_STREAM_STATUS_OK);
    OF(run)(convolver, OF(x)[0], OF(y)[0], 6000, SAMPLES, 100);
    OF(run)(other, OF(x)[0], OF(y)[1], 6000, SAMPLES, 100);
    expect_that("the same bits", !memcmp(OF(y)[0] + 6000, OF(y)[1] + 6000, (SAMPLES - 6000) * sizeof(NUMBER)));
    free(bytes);
    OF(fvi_convolver_free)(convolver);
    OF(fvi_convolver_free)(other);
    OF(fvi_convolver_free)(foreign);
}

static void OF(check_refused)(void) {
    NUMBER taps[] = {(NUMBER)1.0, (NUMBER)0.5}, bad[] = {(NUMBER)1.0, (NUMBER)NAN};
    Of(FviResponse) response = {taps, 2}, spoiled = {bad, 2}, none = {NULL, 0}, lost = {NULL, 2}, vast = {taps, SIZE_MAX};
    Of(FviResponse) askew = {(const NUMBER *)(const void *)((const char *)taps + 1), 1};
    FviStream stream = {0, 0, 0}, late = {((size_t)1 << 24) + 1, 0, 0}, lasting = {0, 0, ((size_t)1 << 28) + 1};
    Of(FviConvolver) *convolver = NULL;
#define NEW(responses, inputs, outputs, stream) OF(fvi_convolver_new)(responses, inputs, outputs, stream, &convolver)
    expect("no responses", NEW(NULL, 1, 1, &stream), FVI_STREAM_STATUS_NULL);
    expect("no stream", NEW(&response, 1, 1, NULL), FVI_STREAM_STATUS_NULL);
    expect("no place", OF(fvi_convolver_new)(&response, 1, 1, &stream, NULL), FVI_STREAM_STATUS_NULL);
    expect("no inputs", NEW(&response, 0, 1, &stream), FVI_STREAM_STATUS_NO_RESPONSE);
    expect("no outputs", NEW(&response, 1, 0, &stream), FVI_STREAM_STATUS_NO_RESPONSE);
    expect("empty", NEW(&none, 1, 1, &stream), FVI_STREAM_STATUS_NO_RESPONSE);
    expect("lost", NEW(&lost, 1, 1, &stream), FVI_STREAM_STATUS_NULL);
    expect("askew", NEW(&askew, 1, 1, &stream), FVI_STREAM_STATUS_MISALIGNED);
    expect("vast", NEW(&vast, 1, 1, &stream), FVI_STREAM_STATUS_OUT_OF_RANGE);
    expect("vast matrix", NEW(&response, SIZE_MAX / 2, 3, &stream), FVI_STREAM_STATUS_OUT_OF_RANGE);
    expect("not finite", NEW(&spoiled, 1, 1, &stream), FVI_STREAM_STATUS_RESPONSE_NOT_FINITE);
    expect("latency", NEW(&response, 1, 1, &late), FVI_STREAM_STATUS_LATENCY);
    expect("longest", NEW(&response, 1, 1, &lasting), FVI_STREAM_STATUS_LONGEST);
    expect_that("nothing was made", convolver == NULL);
    expect("new", NEW(&response, 1, 1, &stream), FVI_STREAM_STATUS_OK);
#undef NEW

    NUMBER input[] = {(NUMBER)1.0, (NUMBER)INFINITY}, output[] = {(NUMBER)7.0, (NUMBER)7.0};
    const NUMBER *inputs[] = {input};
    NUMBER *outputs[] = {output};
    expect("not finite", OF(fvi_convolver_process)(convolver, inputs, outputs, 2), FVI_STREAM_STATUS_SAMPLE_NOT_FINITE);
    expect("no convolver", OF(fvi_convolver_process)(NULL, inputs, outputs, 1), FVI_STREAM_STATUS_NULL);
    expect("no inputs", OF(fvi_convolver_process)(convolver, NULL, outputs, 1), FVI_STREAM_STATUS_NULL);
    expect("no outputs", OF(fvi_convolver_process)(convolver, inputs, NULL, 1), FVI_STREAM_STATUS_NULL);
    expect("no input", OF(fvi_convolver_process)(convolver, (const NUMBER *const[]){NULL}, outputs, 1), FVI_STREAM_STATUS_NULL);
    expect("no output", OF(fvi_convolver_process)(convolver, inputs, (NUMBER *const[]){NULL}, 1), FVI_STREAM_STATUS_NULL);
    expect("vast", OF(fvi_convolver_process)(convolver, inputs, outputs, SIZE_MAX), FVI_STREAM_STATUS_OUT_OF_RANGE);
    expect("no facts", OF(fvi_convolver_facts)(convolver, NULL), FVI_STREAM_STATUS_NULL);
    FviConvolverFacts facts;
    expect("facts", OF(fvi_convolver_facts)(convolver, &facts), FVI_STREAM_STATUS_OK);
    expect_that("refused calls change nothing", facts.taken == 0 && output[0] == (NUMBER)7.0);
    expect("clear nothing", OF(fvi_convolver_clear)(NULL), FVI_STREAM_STATUS_NULL);
    expect("save without a place", OF(fvi_convolver_save)(convolver, NULL, 0, NULL), FVI_STREAM_STATUS_NULL);
    expect("restore nothing", OF(fvi_convolver_restore)(convolver, NULL, 4), FVI_STREAM_STATUS_NULL);
    expect("restore an empty state", OF(fvi_convolver_restore)(convolver, NULL, 0), FVI_STREAM_STATUS_WRONG_STATE);

    Of(FviPreparer) *preparer = NULL;
    Of(FviPrepared) *prepared = NULL;
    expect("preparer of nothing", OF(fvi_preparer_new)(NULL, &preparer), FVI_STREAM_STATUS_NULL);
    expect("preparer", OF(fvi_preparer_new)(convolver, &preparer), FVI_STREAM_STATUS_OK);
    Of(FviResponse) two[] = {response, response}, longer = {OF(w)[0], 3};
    expect("two outputs", OF(fvi_preparer_prepare)(preparer, two, 1, 2, &prepared), FVI_STREAM_STATUS_CHANNELS);
    expect("two inputs", OF(fvi_preparer_prepare)(preparer, two, 2, 1, &prepared), FVI_STREAM_STATUS_CHANNELS);
    expect("longer", OF(fvi_preparer_prepare)(preparer, &longer, 1, 1, &prepared), FVI_STREAM_STATUS_RESPONSE_TOO_LONG);
    expect("spoiled", OF(fvi_preparer_prepare)(preparer, &spoiled, 1, 1, &prepared), FVI_STREAM_STATUS_RESPONSE_NOT_FINITE);
    expect("no preparer", OF(fvi_preparer_prepare)(NULL, &response, 1, 1, &prepared), FVI_STREAM_STATUS_NULL);
    expect_that("nothing was prepared", prepared == NULL);
    expect("prepare", OF(fvi_preparer_prepare)(preparer, &response, 1, 1, &prepared), FVI_STREAM_STATUS_OK);
    Of(FviResponse) long_response = {OF(w)[0], LENGTH};
    Of(FviConvolver) *other = OF(made)(&long_response, 1, 1, 0, 0, 0);
    expect("foreign", OF(fvi_convolver_exchange)(other, prepared, 1, NULL), FVI_STREAM_STATUS_FOREIGN);
    expect("no place", OF(fvi_convolver_exchange)(convolver, NULL, 1, NULL), FVI_STREAM_STATUS_NULL);
    expect("still there", OF(fvi_convolver_exchange)(convolver, prepared, 1, NULL), FVI_STREAM_STATUS_OK);
    /* A preparer and a place outlive their convolver. */
    OF(fvi_convolver_free)(convolver);
    OF(fvi_convolver_free)(other);
    OF(fvi_prepared_free)(prepared);
    expect("afterwards", OF(fvi_preparer_prepare)(preparer, &response, 1, 1, &prepared), FVI_STREAM_STATUS_OK);
    OF(fvi_prepared_free)(prepared);
    OF(fvi_preparer_free)(preparer);
    OF(fvi_convolver_free)(NULL);
    OF(fvi_preparer_free)(NULL);
    OF(fvi_prepared_free)(NULL);
}
