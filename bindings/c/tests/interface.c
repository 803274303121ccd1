#include "interface.h"

#include "fvi.h"
#include "endless_integral.h"
#include "half_derivative.h"

#if defined(CHECK_WITH_VALGRIND)
#include <valgrind/memcheck.h>
#define MAKE_DEFINED(place, count) (void)VALGRIND_MAKE_MEM_DEFINED(place, count)
#else
#define MAKE_DEFINED(place, count) ((void)0)
#endif

enum { CAPACITY = 40, STATUSES = 13 };

static void (*tell)(const char *text);
static int failures;
static int reached[STATUSES];
static uint32_t hash = 2166136261u;

static const float not_a_number = __builtin_nanf("");

static void fail(const char *what, const char *why) {
    failures += 1;
    tell("FAILED: ");
    tell(what);
    tell(": ");
    tell(why);
    tell("\n");
}

static void expect(const char *what, int status, int expected) {
    reached[status] = 1;
    if (status != expected) {
        fail(what, fvi_status_text(status));
    }
}

static void expect_that(const char *what, int condition) {
    if (!condition) {
        fail(what, "not so");
    }
}

/* FNV-1a over the bits of a number. */
static void note(float number) {
    union {
        float number;
        uint32_t bits;
    } as = {number};
    for (int byte = 0; byte < 4; ++byte) {
        hash = (hash ^ (as.bits >> 8 * byte & 255u)) * 16777619u;
    }
}

/* A copy of some bytes, to see later whether they have changed. */
typedef struct {
    const unsigned char *place;
    size_t count;
    unsigned char bytes[2048];
} Copy;

static void take(Copy *copy, const void *place, size_t count) {
    /* A state may hold bytes that nothing depends on: padding. They must stay as well, so valgrind need not mind them. */
    MAKE_DEFINED(place, count);
    copy->place = place;
    copy->count = count;
    for (size_t i = 0; i < count; ++i) {
        copy->bytes[i] = copy->place[i];
    }
}

static void expect_unchanged(const char *what, const Copy *copy) {
    for (size_t i = 0; i < copy->count; ++i) {
        if (copy->bytes[i] != copy->place[i]) {
            fail(what, "a refused call changed something");
            return;
        }
    }
}

static void *misaligned(void *pointer) {
    return (char *)pointer + 1;
}

/* --- Weights ------------------------------------------------------------------------------------------------------------ */

static float weights[CAPACITY];

static void check_weights(void) {
    Copy before;
    expect("weights", fvi_weights_bdf(1, 0.5, 0.25, weights, CAPACITY), FVI_STATUS_OK);
    expect_that("Gruenwald-Letnikov weights of a half derivative", weights[0] == 2.0f && weights[1] == -1.0f && weights[2] == -0.25f);
    take(&before, weights, sizeof weights);
    expect("order 7", fvi_weights_bdf(7, 0.5, 0.25, weights, CAPACITY), FVI_STATUS_OUT_OF_RANGE);
    expect("exponent 2", fvi_weights_bdf(1, 2.0, 0.25, weights, CAPACITY), FVI_STATUS_OUT_OF_RANGE);
    expect("step size not a number", fvi_weights_bdf(1, 0.5, not_a_number, weights, CAPACITY), FVI_STATUS_NOT_FINITE);
    expect("weights to NULL", fvi_weights_bdf(1, 0.5, 0.25, NULL, CAPACITY), FVI_STATUS_NULL);
    expect("misaligned weights", fvi_weights_bdf(1, 0.5, 0.25, misaligned(weights), CAPACITY - 1), FVI_STATUS_MISALIGNED);
    expect_unchanged("weights", &before);
}

/* --- Operators ---------------------------------------------------------------------------------------------------------- */

static FviOperator half_derivative;
static float samples[CAPACITY];

static FviMemory ring(uint32_t kind, float *buffer, size_t count) {
    FviMemory memory = {0};
    memory.kind = kind;
    memory.scale = 1.0f;
    memory.weights = weights;
    memory.weight_count = CAPACITY;
    memory.buffer = buffer;
    memory.buffer_count = count;
    return memory;
}

static void check_ring(void) {
    Copy operator_before, samples_before;
    float result = 7.0f;
    expect("push before init", fvi_operator_push(&half_derivative, 1.0f, &result), FVI_STATUS_NOT_INITIALISED);
    expect("clear before init", fvi_operator_clear(&half_derivative), FVI_STATUS_NOT_INITIALISED);

    FviMemory memory = ring(FVI_FULL_MEMORY, samples, CAPACITY);
    take(&operator_before, &half_derivative, sizeof half_derivative);
    expect("init without memory", fvi_operator_init(&half_derivative, NULL, FVI_CAPUTO, 0.0f), FVI_STATUS_NULL);
    expect("init without operator", fvi_operator_init(NULL, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_NULL);
    expect("unknown start", fvi_operator_init(&half_derivative, &memory, 9, 0.0f), FVI_STATUS_OUT_OF_RANGE);
    expect("rise not a number", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO_WITH_RISE, not_a_number), FVI_STATUS_NOT_FINITE);
    memory.kind = 9;
    expect("unknown memory", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OUT_OF_RANGE);
    memory = ring(FVI_FULL_MEMORY, samples, 0);
    expect("empty ring", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_WRONG_SIZE);
    memory = ring(FVI_FULL_MEMORY, samples, SIZE_MAX);
    expect("endless ring", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OUT_OF_RANGE);
    memory = ring(FVI_FULL_MEMORY, misaligned(samples), CAPACITY - 1);
    expect("misaligned ring", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_MISALIGNED);
    memory = ring(FVI_FULL_MEMORY, samples, CAPACITY);
    memory.scale = not_a_number;
    expect("scale not a number", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_NOT_FINITE);
    memory = ring(FVI_FULL_MEMORY, samples, CAPACITY);
    memory.weight_count = 0;
    expect("no weights", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OUT_OF_RANGE);
    expect_unchanged("operator", &operator_before);

    memory = ring(FVI_FULL_MEMORY, samples, CAPACITY);
    expect("init", fvi_operator_init(&half_derivative, &memory, FVI_RIEMANN_LIOUVILLE, 0.0f), FVI_STATUS_OK);
    float plain[CAPACITY];
    for (int k = 0; k < CAPACITY; ++k) {
        plain[k] = (float)(k % 5) - 1.5f;
        float sum = 0.0f;
        for (int n = k; n >= 0; --n) {
            sum += weights[n] * plain[k - n];
        }
        expect("push", fvi_operator_push(&half_derivative, plain[k], &result), FVI_STATUS_OK);
        float error = result - sum;
        expect_that("the operator is the sum", -1e-5f < error && error < 1e-5f);
        note(result);
        if (k == 20) {
            take(&operator_before, &half_derivative, sizeof half_derivative);
            take(&samples_before, samples, sizeof samples);
            expect("sample not a number", fvi_operator_push(&half_derivative, not_a_number, &result), FVI_STATUS_NOT_FINITE);
            expect("result too large", fvi_operator_push(&half_derivative, 3e38f, &result), FVI_STATUS_NOT_FINITE);
            expect("result to NULL", fvi_operator_push(&half_derivative, 1.0f, NULL), FVI_STATUS_NULL);
            expect("no operator", fvi_operator_push(NULL, 1.0f, &result), FVI_STATUS_NULL);
            expect("misaligned result", fvi_operator_push(&half_derivative, 1.0f, misaligned(&result)), FVI_STATUS_MISALIGNED);
            expect("misaligned operator", fvi_operator_push(misaligned(&half_derivative), 1.0f, &result), FVI_STATUS_MISALIGNED);
            expect_unchanged("operator", &operator_before);
            expect_unchanged("samples", &samples_before);
        }
    }
    float last = result;
    take(&operator_before, &half_derivative, sizeof half_derivative);
    take(&samples_before, samples, sizeof samples);
    expect("full", fvi_operator_push(&half_derivative, 1.0f, &result), FVI_STATUS_MEMORY_FULL);
    expect_that("a refused push leaves the result", result == last);
    expect_unchanged("operator", &operator_before);
    expect_unchanged("samples", &samples_before);
    expect("clear", fvi_operator_clear(&half_derivative), FVI_STATUS_OK);
    expect("first push", fvi_operator_push(&half_derivative, 3.0f, &result), FVI_STATUS_OK);
    expect_that("cleared", result == 3.0f * weights[0]);

    memory = ring(FVI_SHORT_MEMORY, samples, 2);
    expect("init", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OK);
    for (int k = 0; k < 10; ++k) {
        expect("push", fvi_operator_push(&half_derivative, (float)k, &result), FVI_STATUS_OK);
    }
    expect_that("two samples back", result == 9.0f * weights[0] + (8.0f * weights[1] + 7.0f * weights[2]));
}

static void check_exponential_sum(void) {
    /* w = 2, 1, 1/2, 1/4, … */
    static const float head[] = {2.0f, 1.0f}, exponentials[8] = {[0] = 0.5f, [4] = 0.5f};
    static float numbers[FVI_EXPONENTIAL_NUMBERS(2, 8, 0, 1)];
    static FviOperator operation;
    float result = 0.0f;
    FviMemory memory = {0};
    memory.kind = FVI_EXPONENTIAL_SUM;
    memory.scale = 1.0f;
    memory.weights = head;
    memory.weight_count = 2;
    memory.exponentials = exponentials;
    memory.exponential_count = 8;
    memory.horizon = 4;
    memory.buffer = numbers;
    memory.buffer_count = sizeof numbers / sizeof *numbers;
    Copy before;
    take(&before, &operation, sizeof operation);
    memory.slow_blocks = 2;
    expect("too many slow blocks", fvi_operator_init(&operation, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OUT_OF_RANGE);
    memory.slow_blocks = 0;
    memory.far_blocks = 1;
    expect("no room for third parts", fvi_operator_init(&operation, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_WRONG_SIZE);
    memory.far_blocks = 0;
    memory.step_size = -1.0;
    expect("a step size below 0", fvi_operator_init(&operation, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OUT_OF_RANGE);
    memory.step_size = 0.5;
    memory.scale = 2.0f;
    expect("a table scaled twice", fvi_operator_init(&operation, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OUT_OF_RANGE);
    memory.step_size = 0.0;
    memory.scale = 1.0f;
    memory.buffer_count -= 1;
    expect("too small a buffer", fvi_operator_init(&operation, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_WRONG_SIZE);
    memory.buffer_count += 1;
    memory.exponentials = NULL;
    expect("no exponentials", fvi_operator_init(&operation, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_NULL);
    memory.exponentials = exponentials;
    expect_unchanged("operator", &before);
    expect("init", fvi_operator_init(&operation, &memory, FVI_RIEMANN_LIOUVILLE, 0.0f), FVI_STATUS_OK);
    const float x[] = {8.0f, 0.0f, 4.0f, 0.0f};
    const float expected[] = {16.0f, 8.0f, 12.0f, 6.0f};
    for (int k = 0; k < 4; ++k) {
        expect("push", fvi_operator_push(&operation, x[k], &result), FVI_STATUS_OK);
        expect_that("decaying by halves", result == expected[k]);
    }
    expect("horizon", fvi_operator_push(&operation, 1.0f, &result), FVI_STATUS_MEMORY_FULL);
    memory.kind |= FVI_FORGET_PAST_HORIZON;
    expect("init", fvi_operator_init(&operation, &memory, FVI_RIEMANN_LIOUVILLE, 0.0f), FVI_STATUS_OK);
    for (int k = 0; k < 9; ++k) {
        expect("push past the horizon", fvi_operator_push(&operation, 1.0f, &result), FVI_STATUS_OK);
    }
    memory.kind = FVI_SHORT_MEMORY | FVI_FORGET_PAST_HORIZON;
    expect("a ring has no horizon", fvi_operator_init(&operation, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OUT_OF_RANGE);
}

/* A memory without an end on either side of 2^32 samples. Its places go round, so that the late one has the bits of the early one. */
static void check_endless(void) {
    enum { ROUND = (ENDLESS_INTEGRAL_HEAD - 2) * ENDLESS_INTEGRAL_SLOW_BLOCKS, EARLY = 60, COUNT = 74 };
    static const uint64_t rounds = (UINT64_C(0x100000000) - 100) / ROUND * ROUND;
    static float early_numbers[ENDLESS_INTEGRAL_NUMBERS(1)], late_numbers[ENDLESS_INTEGRAL_NUMBERS(1)];
    static FviOperator early, late;
    static unsigned char bytes[2048];
    FviMemory memory = {ENDLESS_INTEGRAL_TABLE, .buffer = early_numbers, .buffer_count = ENDLESS_INTEGRAL_NUMBERS(1)};
    float expected = 0.0f, result = 0.0f;
    size_t written = 0;
    expect("scale of an endless table", fvi_memory_scale_bdf(&memory, 1, -0.8, 0.5), FVI_STATUS_OK);
    expect("init", fvi_operator_init(&early, &memory, FVI_RIEMANN_LIOUVILLE, 0.0f), FVI_STATUS_OK);
    memory.buffer = late_numbers;
    expect("init", fvi_operator_init(&late, &memory, FVI_RIEMANN_LIOUVILLE, 0.0f), FVI_STATUS_OK);
    for (int k = 0; k < EARLY; ++k) {
        expect("push", fvi_operator_push(&early, (float)(k % 11) - 4.0f, &expected), FVI_STATUS_OK);
    }
    expect("save", fvi_operator_save(&early, bytes, sizeof bytes, &written), FVI_STATUS_OK);
    expect_that("the count of samples lies where it is changed", bytes[COUNT] == EARLY && bytes[COUNT + 1] == 0);
    for (int byte = 0; byte < 8; ++byte) {
        bytes[COUNT + byte] = (unsigned char)((EARLY + rounds) >> 8 * byte);
    }
    expect("restore", fvi_operator_restore(&late, bytes, written), FVI_STATUS_OK);
    for (int k = 0; k < 300; ++k) {
        expect("push", fvi_operator_push(&early, (float)(k % 13) - 5.0f, &expected), FVI_STATUS_OK);
        expect("push past 2^32", fvi_operator_push(&late, (float)(k % 13) - 5.0f, &result), FVI_STATUS_OK);
        expect_that("the same bits past 2^32 samples", result == expected);
    }
    note(result);
    expect("save", fvi_operator_save(&late, bytes, sizeof bytes, &written), FVI_STATUS_OK);
    expect_that("more than 2^32 samples", bytes[COUNT + 4] == 1);
}

/* The scale of a table is found, whatever step size it holds, and a table of something else is refused. */
static void check_scale(void) {
    FviMemory memory = {ENDLESS_INTEGRAL_TABLE};
    memory.kind |= FVI_ON_INCREMENTS;
    expect("made for h = 1", fvi_memory_scale_bdf(&memory, 1, -0.8, 1e-3), FVI_STATUS_OK);
    /* 1e-3^0.8 */
    expect_that("scaled by h^0.8", 3.9810e-3f < memory.scale && memory.scale < 3.9812e-3f);
    expect_that("on values", memory.kind == FVI_EXPONENTIAL_SUM);
    Copy before;
    take(&before, &memory, sizeof memory);
    expect("another exponent", fvi_memory_scale_bdf(&memory, 1, -0.7, 1e-3), FVI_STATUS_OUT_OF_RANGE);
    expect("another order", fvi_memory_scale_bdf(&memory, 2, -0.8, 1e-3), FVI_STATUS_OUT_OF_RANGE);
    expect("no order", fvi_memory_scale_bdf(&memory, 0, -0.8, 1e-3), FVI_STATUS_OUT_OF_RANGE);
    expect("no step size", fvi_memory_scale_bdf(&memory, 1, -0.8, 0.0), FVI_STATUS_OUT_OF_RANGE);
    expect("not a number", fvi_memory_scale_bdf(&memory, 1, -0.8, (double)not_a_number), FVI_STATUS_NOT_FINITE);
    expect("no memory", fvi_memory_scale_bdf(NULL, 1, -0.8, 1e-3), FVI_STATUS_NULL);
    expect_unchanged("memory", &before);
    memory = (FviMemory){HALF_DERIVATIVE_TABLE};
    expect("made for h = 1/4", fvi_memory_scale_bdf(&memory, 1, 0.5, 0.25), FVI_STATUS_OK);
    expect_that("not scaled again", memory.scale == 1.0f);
    expect("used at another", fvi_memory_scale_bdf(&memory, 1, 0.5, 0.125), FVI_STATUS_OUT_OF_RANGE);
    memory.step_size = 0.125;
    expect("said to hold another", fvi_memory_scale_bdf(&memory, 1, 0.5, 0.125), FVI_STATUS_OUT_OF_RANGE);
    memory = ring(FVI_FULL_MEMORY, samples, CAPACITY);
    memory.scale = 7.0f;
    expect("weights of a ring", fvi_memory_scale_bdf(&memory, 1, 0.5, 0.25), FVI_STATUS_OK);
    expect_that("that hold their step size", memory.scale == 1.0f && memory.kind == FVI_FULL_MEMORY);
}

/* A look ahead, and two operators in one tick. */
static void check_ticks(void) {
    static float buffers[2][CAPACITY];
    static FviOperator first, second;
    Copy first_before, second_before;
    FviMemory memory = ring(FVI_FULL_MEMORY, buffers[0], CAPACITY);
    expect("init", fvi_operator_init(&first, &memory, FVI_RIEMANN_LIOUVILLE, 0.0f), FVI_STATUS_OK);
    memory.buffer = buffers[1];
    expect("init", fvi_operator_init(&second, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OK);
    float values[2] = {5.0f, 6.0f}, peeked = 7.0f;
    expect("a tick", fvi_operator_push_two(&first, &second, (const float[]){1.0f, 2.0f}, values), FVI_STATUS_OK);
    expect_that("both values", values[0] == weights[0] && values[1] == 0.0f);
    take(&first_before, &first, sizeof first);
    take(&second_before, &second, sizeof second);
    expect("the second not a number", fvi_operator_push_two(&first, &second, (const float[]){1.0f, not_a_number}, values), FVI_STATUS_NOT_FINITE);
    expect("the first not a number", fvi_operator_push_two(&first, &second, (const float[]){not_a_number, 1.0f}, values), FVI_STATUS_NOT_FINITE);
    expect("one operator twice", fvi_operator_push_two(&first, &first, (const float[]){1.0f, 1.0f}, values), FVI_STATUS_OUT_OF_RANGE);
    expect("no samples", fvi_operator_push_two(&first, &second, NULL, values), FVI_STATUS_NULL);
    expect("no results", fvi_operator_push_two(&first, &second, (const float[]){1.0f, 1.0f}, NULL), FVI_STATUS_NULL);
    expect("no second", fvi_operator_push_two(&first, NULL, (const float[]){1.0f, 1.0f}, values), FVI_STATUS_NULL);
    expect_that("refused ticks write nothing", values[0] == weights[0] && values[1] == 0.0f);
    expect("peek", fvi_operator_peek(&first, 3.0f, &peeked), FVI_STATUS_OK);
    expect("peek at no number", fvi_operator_peek(&first, not_a_number, &values[0]), FVI_STATUS_NOT_FINITE);
    expect_unchanged("first operator", &first_before);
    expect_unchanged("second operator", &second_before);
    expect("push", fvi_operator_push(&first, 3.0f, &values[0]), FVI_STATUS_OK);
    expect_that("as peeked", values[0] == peeked);
    note(peeked);
}

/* The same half derivative from a ring and from the table that `fvi exponentials --format c` has made. */
static void check_table(void) {
    static float numbers[HALF_DERIVATIVE_NUMBERS(1)];
    static FviOperator short_of_nothing;
    FviMemory memory = ring(FVI_FULL_MEMORY, samples, CAPACITY);
    expect("init", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OK);
    memory = (FviMemory){
        HALF_DERIVATIVE_TABLE,
        .buffer = numbers,
        .buffer_count = sizeof numbers / sizeof *numbers,
    };
    expect("init", fvi_operator_init(&short_of_nothing, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OK);
    for (int k = 0; k < CAPACITY; ++k) {
        float sample = (float)(k % 7) - 2.0f, from_ring = 0.0f, from_table = 0.0f;
        expect("push", fvi_operator_push(&half_derivative, sample, &from_ring), FVI_STATUS_OK);
        expect("push", fvi_operator_push(&short_of_nothing, sample, &from_table), FVI_STATUS_OK);
        float error = from_ring - from_table;
        expect_that("table and ring agree", -2e-5f < error && error < 2e-5f);
        note(from_table);
    }
}

/* The same half derivative from weights on increments. */
static void check_increments(void) {
    static float sums[CAPACITY], values[CAPACITY], increments[CAPACITY];
    static FviOperator on_values, on_increments;
    expect("sums", fvi_increment_weights_bdf(1, 0.5, 0.25, sums, CAPACITY), FVI_STATUS_OK);
    expect("sums to NULL", fvi_increment_weights_bdf(1, 0.5, 0.25, NULL, CAPACITY), FVI_STATUS_NULL);
    expect("sums of order 0", fvi_increment_weights_bdf(0, 0.5, 0.25, sums, CAPACITY), FVI_STATUS_OUT_OF_RANGE);
    FviMemory memory = ring(FVI_FULL_MEMORY, values, CAPACITY);
    expect("init", fvi_operator_init(&on_values, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OK);
    memory = ring(FVI_FULL_MEMORY | FVI_ON_INCREMENTS, increments, CAPACITY);
    memory.weights = sums;
    expect("init", fvi_operator_init(&on_increments, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OK);
    for (int k = 0; k < CAPACITY; ++k) {
        float sample = (float)(k % 5) - 1.0f, plain = 0.0f, summed = 0.0f;
        expect("push", fvi_operator_push(&on_values, sample, &plain), FVI_STATUS_OK);
        expect("push", fvi_operator_push(&on_increments, sample, &summed), FVI_STATUS_OK);
        expect_that("increments and values agree", -2e-5f < plain - summed && plain - summed < 2e-5f);
        note(summed);
    }
}

/* --- Steppers ----------------------------------------------------------------------------------------------------------- */

/* Uncoupled springs, hardening a little; the Hessian is multiplied by `lie`. */
typedef struct {
    int coordinates;
    float stiffness;
    float hardening;
    float lie;
} Springs;

static void gradient(void *context, const float *position, float *result) {
    const Springs *springs = context;
    for (int i = 0; i < springs->coordinates; ++i) {
        float q = position[i];
        result[i] = springs->stiffness * q + springs->hardening * q * q * q;
    }
}

static void hessian(void *context, const float *position, float *result) {
    const Springs *springs = context;
    int n = springs->coordinates;
    for (int i = 0; i < n * n; ++i) {
        float q = position[i / n];
        result[i] = i / n == i % n ? springs->lie * (springs->stiffness + 3.0f * springs->hardening * q * q) : 0.0f;
    }
}

static void push_until_one(void *context, float time, const float *position, float *force) {
    (void)position;
    for (int i = 0; i < ((const Springs *)context)->coordinates; ++i) {
        force[i] = time <= 1.0f ? 2.0f : 0.0f;
    }
}

/* Room for any stepper. */
static union {
    FviStepper1 one;
    FviStepper2 two;
    FviStepper3 three;
    FviStepper4 four;
    FviStepper5 five;
    FviStepper6 six;
} storage;

static int init(int n, const FviSystem *system, FviStepper **stepper) {
    switch (n) {
    case 1: return fvi_stepper_init_1(&storage.one, system, stepper);
    case 2: return fvi_stepper_init_2(&storage.two, system, stepper);
    case 3: return fvi_stepper_init_3(&storage.three, system, stepper);
    case 4: return fvi_stepper_init_4(&storage.four, system, stepper);
    case 5: return fvi_stepper_init_5(&storage.five, system, stepper);
    default: return fvi_stepper_init_6(&storage.six, system, stepper);
    }
}

static int init_at_node(int n, const FviSystem *system, FviStepper **stepper) {
    switch (n) {
    case 1: return fvi_stepper_init_at_node_1(&storage.one, system, stepper);
    case 2: return fvi_stepper_init_at_node_2(&storage.two, system, stepper);
    case 3: return fvi_stepper_init_at_node_3(&storage.three, system, stepper);
    case 4: return fvi_stepper_init_at_node_4(&storage.four, system, stepper);
    case 5: return fvi_stepper_init_at_node_5(&storage.five, system, stepper);
    default: return fvi_stepper_init_at_node_6(&storage.six, system, stepper);
    }
}

static float history[6 * CAPACITY];

typedef struct {
    Springs springs;
    FviMemory memory;
    FviSystem system;
    float mass[36], damping[36], position[6], momentum[6];
} Plant;

/* Fills in an uncoupled plant with h = 1/4, so that the weights above are those of its damping. */
static void describe(Plant *plant, int n) {
    *plant = (Plant){0};
    plant->springs = (Springs){n, 1.0f, 0.25f, 1.0f};
    plant->memory = ring(FVI_FULL_MEMORY, history, (size_t)(n * CAPACITY));
    for (int i = 0; i < n; ++i) {
        plant->mass[i * n + i] = 1.0f;
        plant->damping[i * n + i] = 0.5f;
        plant->position[i] = 1.0f;
    }
    plant->system = (FviSystem){
        .mass = plant->mass,
        .damping = plant->damping,
        .damping_order = 0.5f,
        .derivative = FVI_CAPUTO,
        .memory = &plant->memory,
        .step_size = 0.25f,
        .kappa = 0.5f,
        .position = plant->position,
        .momentum = plant->momentum,
        .gradient = gradient,
        .hessian = hessian,
        .force = push_until_one,
        .context = &plant->springs,
    };
}

/* Damped at its node the memory takes no sample at t = 0: one step more fits. */
static void check_trajectories_at_the_node(void) {
    static float alone[CAPACITY + 1];
    for (int n = 1; n <= 6; ++n) {
        Plant plant;
        FviStepper *stepper = NULL;
        float q[6], p[6];
        uint64_t steps = 0;
        describe(&plant, n);
        expect("init at the node", init_at_node(n, &plant.system, &stepper), FVI_STATUS_OK);
        for (int k = 1; k <= CAPACITY; ++k) {
            expect("step", fvi_stepper_step(stepper, NULL), FVI_STATUS_OK);
            expect("state", fvi_stepper_state(stepper, q, p, &steps), FVI_STATUS_OK);
            if (n == 1) {
                alone[k] = q[0];
            }
            for (int i = 0; i < n; ++i) {
                expect_that("uncoupled coordinates move as if alone", q[i] == alone[k]);
                note(q[i]);
                note(p[i]);
            }
        }
        expect_that("steps are counted", steps == CAPACITY);
        expect("full", fvi_stepper_step(stepper, NULL), FVI_STATUS_MEMORY_FULL);
    }
    expect_that("damped", -0.6f < alone[CAPACITY] && alone[CAPACITY] < 0.6f);
}

static void check_trajectories(void) {
    static float alone[CAPACITY];
    for (int n = 1; n <= 6; ++n) {
        Plant plant;
        FviStepper *stepper = NULL;
        float q[6], p[6];
        uint64_t steps = 0;
        describe(&plant, n);
        expect("init", init(n, &plant.system, &stepper), FVI_STATUS_OK);
        for (int k = 1; k < CAPACITY; ++k) {
            expect("step", fvi_stepper_step(stepper, NULL), FVI_STATUS_OK);
            expect("state", fvi_stepper_state(stepper, q, p, &steps), FVI_STATUS_OK);
            if (n == 1) {
                alone[k] = q[0];
            }
            for (int i = 0; i < n; ++i) {
                expect_that("uncoupled coordinates move as if alone", q[i] == alone[k]);
                note(q[i]);
                note(p[i]);
            }
        }
        expect_that("steps are counted", steps == CAPACITY - 1);
        expect("full", fvi_stepper_step(stepper, NULL), FVI_STATUS_MEMORY_FULL);
    }
    expect_that("damped", -0.6f < alone[CAPACITY - 1] && alone[CAPACITY - 1] < 0.6f);
}

static void check_bad_steppers(void) {
    Plant plant;
    FviStepper *stepper = NULL;
    Copy before;
    for (int i = 0; i < FVI_STEPPER_WORDS_6; ++i) {
        storage.six.words[i] = 0;
    }
    stepper = (FviStepper *)&storage;
    float q[2];
    expect("step before init", fvi_stepper_step(stepper, NULL), FVI_STATUS_NOT_INITIALISED);
    expect("state before init", fvi_stepper_state(stepper, q, NULL, NULL), FVI_STATUS_NOT_INITIALISED);
    take(&before, &storage, sizeof storage);
    stepper = NULL;

#define REFUSED(what, change, status) \
    do { \
        describe(&plant, 2); \
        change; \
        expect(what, init(2, &plant.system, &stepper), status); \
        expect_unchanged(what, &before); \
        expect_that("no stepper", stepper == NULL); \
    } while (0)
    REFUSED("no mass", plant.system.mass = NULL, FVI_STATUS_NULL);
    REFUSED("no gradient", plant.system.gradient = NULL, FVI_STATUS_NULL);
    REFUSED("no Hessian", plant.system.hessian = NULL, FVI_STATUS_NULL);
    REFUSED("no memory", plant.system.memory = NULL, FVI_STATUS_NULL);
    REFUSED("misaligned position", plant.system.position = misaligned(plant.position), FVI_STATUS_MISALIGNED);
    REFUSED("asymmetric mass", plant.mass[1] = 0.5f, FVI_STATUS_NOT_SYMMETRIC);
    REFUSED("negative mass", plant.mass[0] = -1.0f, FVI_STATUS_NOT_POSITIVE);
    REFUSED("negative damping", plant.damping[0] = -1.0f, FVI_STATUS_NOT_POSITIVE);
    REFUSED("mass not a number", plant.mass[0] = not_a_number, FVI_STATUS_NOT_FINITE);
    REFUSED("position not a number", plant.position[0] = not_a_number, FVI_STATUS_NOT_FINITE);
    REFUSED("damping order 2", plant.system.damping_order = 2.0f, FVI_STATUS_OUT_OF_RANGE);
    REFUSED("kappa 2", plant.system.kappa = 2.0f, FVI_STATUS_OUT_OF_RANGE);
    REFUSED("no step", plant.system.step_size = 0.0f, FVI_STATUS_OUT_OF_RANGE);
    REFUSED("unknown derivative", plant.system.derivative = 5, FVI_STATUS_OUT_OF_RANGE);
    REFUSED("buffer for one and a half channels", plant.memory.buffer_count = 3, FVI_STATUS_WRONG_SIZE);
    describe(&plant, 2);
    expect("no storage", fvi_stepper_init_2(NULL, &plant.system, &stepper), FVI_STATUS_NULL);
    expect("misaligned storage", fvi_stepper_init_2(misaligned(&storage), &plant.system, &stepper), FVI_STATUS_MISALIGNED);
    expect("no system", fvi_stepper_init_2(&storage.two, NULL, &stepper), FVI_STATUS_NULL);
    expect("nowhere to put the stepper", fvi_stepper_init_2(&storage.two, &plant.system, NULL), FVI_STATUS_NULL);
    expect_unchanged("stepper", &before);
}

/* A step fails, nothing changes, and the next one goes on as if nothing had happened. */
static void check_failed_steps(void) {
    Plant plant;
    FviStepper *stepper = NULL;
    Copy before, history_before;
    float input[1] = {not_a_number};
    describe(&plant, 1);
    plant.system.force = NULL;
    expect("init", init(1, &plant.system, &stepper), FVI_STATUS_OK);
    expect("step", fvi_stepper_step(stepper, NULL), FVI_STATUS_OK);
    take(&before, &storage.one, sizeof storage.one);
    take(&history_before, history, sizeof history);
    expect("input not a number", fvi_stepper_step(stepper, input), FVI_STATUS_NOT_FINITE);
    expect("misaligned input", fvi_stepper_step(stepper, misaligned(input)), FVI_STATUS_MISALIGNED);
    expect("no stepper", fvi_stepper_step(NULL, NULL), FVI_STATUS_NULL);
    expect("misaligned state", fvi_stepper_state(stepper, misaligned(input), NULL, NULL), FVI_STATUS_MISALIGNED);
    plant.springs.stiffness = not_a_number;
    expect("gradient not a number", fvi_stepper_step(stepper, NULL), FVI_STATUS_NOT_FINITE);
    /* 4m/h² = 64 decides what the Jacobian −m/h − hK/4 is: zero for K = −64, half of it for K = 64 when the gradient has 192. */
    plant.springs = (Springs){1, 64.0f, 0.0f, -1.0f};
    expect("singular", fvi_stepper_step(stepper, NULL), FVI_STATUS_SINGULAR);
    plant.springs = (Springs){1, 192.0f, 0.0f, 1.0f / 3.0f};
    expect("a Hessian that is not one", fvi_stepper_step(stepper, NULL), FVI_STATUS_NOT_CONVERGED);
    expect_unchanged("stepper", &before);
    expect_unchanged("history", &history_before);
    plant.springs = (Springs){1, 1.0f, 0.25f, 1.0f};
    float q = 0.0f;
    expect("step again", fvi_stepper_step(stepper, NULL), FVI_STATUS_OK);
    expect("state", fvi_stepper_state(stepper, &q, NULL, NULL), FVI_STATUS_OK);
    note(q);
}

/* --- Restarts ----------------------------------------------------------------------------------------------------------- */

static int save(int n, const FviStepper *stepper, uint8_t *bytes, size_t capacity, size_t *written) {
    switch (n) {
    case 1: return fvi_stepper_save_1(stepper, bytes, capacity, written);
    case 2: return fvi_stepper_save_2(stepper, bytes, capacity, written);
    case 3: return fvi_stepper_save_3(stepper, bytes, capacity, written);
    case 4: return fvi_stepper_save_4(stepper, bytes, capacity, written);
    case 5: return fvi_stepper_save_5(stepper, bytes, capacity, written);
    default: return fvi_stepper_save_6(stepper, bytes, capacity, written);
    }
}

static int restore(int n, FviStepper *stepper, const uint8_t *bytes, size_t count) {
    switch (n) {
    case 1: return fvi_stepper_restore_1(stepper, bytes, count);
    case 2: return fvi_stepper_restore_2(stepper, bytes, count);
    case 3: return fvi_stepper_restore_3(stepper, bytes, count);
    case 4: return fvi_stepper_restore_4(stepper, bytes, count);
    case 5: return fvi_stepper_restore_5(stepper, bytes, count);
    default: return fvi_stepper_restore_6(stepper, bytes, count);
    }
}

static uint8_t saved[2048];

/* A stepper that is set up anew and takes over the saved state makes the steps that the first one made. */
static void check_restarts(void) {
    for (int n = -6; n <= 6; ++n) {
        if (n == 0) {
            continue;
        }
        int count = n < 0 ? -n : n;
        Plant plant;
        FviStepper *stepper = NULL;
        float expected[6], q[6], p[6];
        uint64_t steps = 0;
        size_t needed = 0, written = 0;
        Copy before;
        describe(&plant, count);
        expect("init", n < 0 ? init_at_node(count, &plant.system, &stepper) : init(count, &plant.system, &stepper), FVI_STATUS_OK);
        for (int k = 0; k < 10; ++k) {
            expect("step", fvi_stepper_step(stepper, NULL), FVI_STATUS_OK);
        }
        expect("size of the state", save(count, stepper, NULL, 0, &needed), FVI_STATUS_OK);
        expect_that("the state fits", needed <= sizeof saved);
        written = 7;
        take(&before, saved, sizeof saved);
        expect("no room", save(count, stepper, saved, needed - 1, &written), FVI_STATUS_WRONG_SIZE);
        expect("saved with another number of coordinates", save(count % 6 + 1, stepper, saved, sizeof saved, &written), FVI_STATUS_WRONG_SIZE);
        expect("nowhere to save to", save(count, stepper, NULL, needed, &written), FVI_STATUS_NULL);
        expect_that("no count", written == 7);
        expect_unchanged("saved bytes", &before);
        expect("save", save(count, stepper, saved, sizeof saved, &written), FVI_STATUS_OK);
        expect_that("as many bytes as it said", written == needed);
        for (int k = 0; k < 10; ++k) {
            expect("step", fvi_stepper_step(stepper, NULL), FVI_STATUS_OK);
        }
        expect("state", fvi_stepper_state(stepper, expected, NULL, NULL), FVI_STATUS_OK);
        for (size_t i = 0; i < sizeof storage; ++i) {
            ((unsigned char *)&storage)[i] = 0;
        }
        for (int i = 0; i < 6 * CAPACITY; ++i) {
            history[i] = 0.0f;
        }
        expect("restored before it is set up", restore(count, (FviStepper *)&storage, saved, written), FVI_STATUS_NOT_INITIALISED);
        describe(&plant, count);
        expect("init", n < 0 ? init_at_node(count, &plant.system, &stepper) : init(count, &plant.system, &stepper), FVI_STATUS_OK);
        take(&before, &storage, sizeof storage);
        expect("a state cut off", restore(count, stepper, saved, written - 1), FVI_STATUS_WRONG_STATE);
        expect("restored with another number of coordinates", restore(count % 6 + 1, stepper, saved, written), FVI_STATUS_WRONG_SIZE);
        saved[0] = (uint8_t)(saved[0] ^ 1u);
        expect("a state with a wrong beginning", restore(count, stepper, saved, written), FVI_STATUS_WRONG_STATE);
        saved[0] = (uint8_t)(saved[0] ^ 1u);
        expect_unchanged("stepper", &before);
        expect("restore", restore(count, stepper, saved, sizeof saved), FVI_STATUS_OK);
        for (int k = 0; k < 10; ++k) {
            expect("step", fvi_stepper_step(stepper, NULL), FVI_STATUS_OK);
        }
        expect("state", fvi_stepper_state(stepper, q, p, &steps), FVI_STATUS_OK);
        expect_that("steps go on", steps == 20);
        for (int i = 0; i < count; ++i) {
            expect_that("the same bits after a restart", q[i] == expected[i]);
            note(p[i]);
        }
    }
}

static void check_restarted_operators(void) {
    static float numbers[HALF_DERIVATIVE_NUMBERS(1)];
    for (int kind = 0; kind < 2; ++kind) {
        FviMemory memory = ring(FVI_FULL_MEMORY, samples, CAPACITY);
        if (kind) {
            memory = (FviMemory){HALF_DERIVATIVE_TABLE, .buffer = numbers};
            memory.buffer_count = sizeof numbers / sizeof *numbers;
        }
        float expected = 0.0f, result = 0.0f;
        size_t written = 0;
        expect("operator", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OK);
        for (int k = 0; k < 20; ++k) {
            expect("push", fvi_operator_push(&half_derivative, (float)(k * k % 7), &result), FVI_STATUS_OK);
        }
        expect("save", fvi_operator_save(&half_derivative, saved, sizeof saved, &written), FVI_STATUS_OK);
        expect("push", fvi_operator_push(&half_derivative, 3.0f, &expected), FVI_STATUS_OK);
        expect("operator", fvi_operator_init(&half_derivative, &memory, FVI_CAPUTO, 0.0f), FVI_STATUS_OK);
        expect("a state cut off", fvi_operator_restore(&half_derivative, saved, written - 4), FVI_STATUS_WRONG_STATE);
        expect("restore", fvi_operator_restore(&half_derivative, saved, written), FVI_STATUS_OK);
        expect("push", fvi_operator_push(&half_derivative, 3.0f, &result), FVI_STATUS_OK);
        expect_that("the same bits after a restart", result == expected);
        expect("operator", fvi_operator_init(&half_derivative, &memory, FVI_RIEMANN_LIOUVILLE, 0.0f), FVI_STATUS_OK);
        expect("another start", fvi_operator_restore(&half_derivative, saved, written), FVI_STATUS_WRONG_STATE);
        note(result);
    }
}

static FviPid controller;

static int is_name(const char *name, const char *expected) {
    while (name && *name && *name == *expected) {
        ++name;
        ++expected;
    }
    return name && *name == *expected;
}

/* The member of the settings that is refused has its name. */
static void check_names(const FviPidSettings *fine) {
    FviPidSettings wrong = *fine;
    expect_that("nothing refused", fvi_pid_refused(fine) == NULL);
    expect_that("no settings", is_name(fvi_pid_refused(NULL), "settings"));
#define EXPECT_REFUSED(name, member, value) \
    wrong = *fine; \
    wrong.member = value; \
    expect_that(name " by name", is_name(fvi_pid_refused(&wrong), name))
    EXPECT_REFUSED("sample", sample, -1.0);
    EXPECT_REFUSED("lambda", lambda, 2.0);
    EXPECT_REFUSED("mu", mu, -0.5);
    EXPECT_REFUSED("filter_time", filter_time, -1.0);
    EXPECT_REFUSED("filter_order", filter_order, 3.0);
    EXPECT_REFUSED("tracking_time", tracking_time, 0.0);
    EXPECT_REFUSED("kp", kp, not_a_number);
    EXPECT_REFUSED("ki", ki, not_a_number);
    EXPECT_REFUSED("kd", kd, not_a_number);
    EXPECT_REFUSED("setpoint_weights", setpoint_weights[1], not_a_number);
    EXPECT_REFUSED("limits", limits[0], 3.0f);
    EXPECT_REFUSED("rate_limit", rate_limit, -1.0f);
    EXPECT_REFUSED("form", form, 7);
    EXPECT_REFUSED("derivative_of", derivative_of, 7);
    EXPECT_REFUSED("anti_windup", anti_windup, 7);
    EXPECT_REFUSED("bumpless", bumpless, 7);
    EXPECT_REFUSED("filter_ratio", form, FVI_PID_SERIES);
}

/* P and PD controllers have no memory of an integral; PI of order 1 has none either. */
static void check_plain_controllers(void) {
    static FviPid plain;
    static float weights[2] = {100.0f, -100.0f}, samples[2];
    float output = 0.0f;
    FviPidSettings settings = {.sample = 0.01, .kp = 2.0f, .setpoint_weights = {1.0f, 0.0f}};
    expect("P", fvi_pid_init(&plain, &settings, NULL, NULL, NULL), FVI_STATUS_OK);
    expect("tick", fvi_pid_tick(&plain, 3.0f, 1.0f, &output), FVI_STATUS_OK);
    expect_that("P", output == 4.0f);
    settings.ki = 5.0f;
    expect("PI", fvi_pid_set(&plain, &settings), FVI_STATUS_OK);
    expect("tick", fvi_pid_tick(&plain, 3.0f, 1.0f, &output), FVI_STATUS_OK);
    expect("tick", fvi_pid_tick(&plain, 3.0f, 1.0f, &output), FVI_STATUS_OK);
    expect_that("PI", output > 4.09f && output < 4.11f);
    settings.ki = 0.0f;
    settings.kd = 0.1f;
    expect("kd without its memory", fvi_pid_set(&plain, &settings), FVI_STATUS_OUT_OF_RANGE);
    FviMemory derivative = ring(FVI_SHORT_MEMORY, samples, 2);
    derivative.weights = weights;
    derivative.weight_count = 2;
    expect("PD", fvi_pid_init(&plain, &settings, NULL, &derivative, NULL), FVI_STATUS_OK);
    expect("tick", fvi_pid_tick(&plain, 20.0f, 20.0f, &output), FVI_STATUS_OK);
    expect_that("at rest no kick", output == 0.0f);
    expect("tick", fvi_pid_tick(&plain, 20.0f, 20.5f, &output), FVI_STATUS_OK);
    expect_that("PD", output > -6.001f && output < -5.999f);
    settings.derivative_of = FVI_PID_OF_VALUES;
    expect("PD of values", fvi_pid_init(&plain, &settings, NULL, &derivative, NULL), FVI_STATUS_OK);
    expect("tick", fvi_pid_tick(&plain, 20.0f, 20.0f, &output), FVI_STATUS_OK);
    expect_that("a kick on request", output > -200.001f && output < -199.999f);
    settings.lambda = 0.5;
    expect("a fractional order without memory", fvi_pid_init(&plain, &settings, NULL, &derivative, NULL), FVI_STATUS_NULL);
}

/* A loop of first order, with limits, back-calculation, a hand on it, and a restart. */
static void check_controller(void) {
    static float integral_weights[CAPACITY], derivative_weights[CAPACITY], integral_samples[CAPACITY], derivative_samples[CAPACITY];
    Copy before, samples_before;
    float output = 7.0f;
    expect("tick before init", fvi_pid_tick(&controller, 1.0f, 0.0f, &output), FVI_STATUS_NOT_INITIALISED);
    expect("weights", fvi_weights_bdf(1, -0.8, 0.01, integral_weights, CAPACITY), FVI_STATUS_OK);
    expect("weights", fvi_weights_bdf(1, 0.6, 0.01, derivative_weights, CAPACITY), FVI_STATUS_OK);
    FviMemory integral = ring(FVI_SHORT_MEMORY, integral_samples, CAPACITY);
    FviMemory derivative = ring(FVI_SHORT_MEMORY, derivative_samples, CAPACITY);
    integral.weights = integral_weights;
    derivative.weights = derivative_weights;
    FviPidSettings settings = {
        .sample = 0.01, .lambda = 0.8, .mu = 0.6, .filter_time = 0.02, .tracking_time = 0.1, .kp = 2.0f, .ki = 3.0f, .kd = 0.1f,
        .setpoint_weights = {1.0f, 0.0f}, .limits = {-2.0f, 2.0f}, .rate_limit = 300.0f, .anti_windup = FVI_PID_BACK_CALCULATION,
    };
    take(&before, &controller, sizeof controller);
    check_names(&settings);
    expect("no settings", fvi_pid_init(&controller, NULL, &integral, &derivative, NULL), FVI_STATUS_NULL);
    expect("no integral", fvi_pid_init(&controller, &settings, NULL, &derivative, NULL), FVI_STATUS_NULL);
    expect("no derivative", fvi_pid_init(&controller, &settings, &integral, NULL, NULL), FVI_STATUS_OUT_OF_RANGE);
    expect("wrong weights", fvi_pid_init(&controller, &settings, &derivative, &derivative, NULL), FVI_STATUS_OUT_OF_RANGE);
    settings.form = 7;
    expect("unknown form", fvi_pid_init(&controller, &settings, &integral, &derivative, NULL), FVI_STATUS_OUT_OF_RANGE);
    settings.form = FVI_PID_PARALLEL;
    settings.kp = not_a_number;
    expect("gain not a number", fvi_pid_init(&controller, &settings, &integral, &derivative, NULL), FVI_STATUS_NOT_FINITE);
    settings.kp = 2.0f;
    settings.lambda = 2.0;
    expect("order", fvi_pid_init(&controller, &settings, &integral, &derivative, NULL), FVI_STATUS_OUT_OF_RANGE);
    settings.lambda = 0.8;
    expect_unchanged("controller", &before);
    expect("init", fvi_pid_init(&controller, &settings, &integral, &derivative, NULL), FVI_STATUS_OK);
    float plant = 0.0f, expected = 0.0f;
    size_t written = 0;
    for (int k = 0; k < 200; ++k) {
        if (k == 60) {
            take(&before, &controller, sizeof controller);
            take(&samples_before, integral_samples, sizeof integral_samples);
            FviPidInputs inputs = {.setpoint = 1.0f, .measured = plant, .actuator = 9};
            expect("unknown actuator", fvi_pid_tick_with(&controller, &inputs, &output), FVI_STATUS_OUT_OF_RANGE);
            inputs.actuator = FVI_PID_APPLIED;
            inputs.applied = not_a_number;
            expect("applied", fvi_pid_tick_with(&controller, &inputs, &output), FVI_STATUS_NOT_FINITE);
            expect("measured", fvi_pid_tick(&controller, 1.0f, not_a_number, &output), FVI_STATUS_NOT_FINITE);
            expect("no output", fvi_pid_tick(&controller, 1.0f, plant, NULL), FVI_STATUS_NULL);
            expect("manual", fvi_pid_manual(&controller, not_a_number), FVI_STATUS_NOT_FINITE);
            expect("gains", fvi_pid_set_gains(&controller, not_a_number, 1.0f, 0.0f), FVI_STATUS_NOT_FINITE);
            expect_unchanged("controller", &before);
            expect_unchanged("samples", &samples_before);
            expect("manual", fvi_pid_manual(&controller, 0.5f), FVI_STATUS_OK);
        }
        if (k == 90) {
            expect("automatic", fvi_pid_automatic(&controller), FVI_STATUS_OK);
        }
        if (k == 120) {
            expect("gains", fvi_pid_set_gains(&controller, 1.0f, 2.0f, 0.05f), FVI_STATUS_OK);
        }
        float last = output;
        expect("tick", fvi_pid_tick(&controller, k < 150 ? 1.0f : 5.0f, plant, &output), FVI_STATUS_OK);
        expect_that("limits hold", -2.0f <= output && output <= 2.0f);
        float bump = output - last;
        if (k == 90) {
            expect_that("no bump", -1e-5f < bump && bump < 1e-5f);
        }
        plant += 0.05f * (output - plant);
        note(output);
    }
    /* Limits, weights, tracking and rate change while it runs; orders do not. */
    float term = 0.0f;
    expect("state", fvi_pid_state(&controller, &expected, &term), FVI_STATUS_OK);
    expect_that("the last output", expected == output && term != 0.0f);
    settings.limits[1] = output - 0.25f;
    settings.setpoint_weights[0] = 0.5f;
    settings.tracking_time = 0.05;
    settings.rate_limit = 10.0f;
    settings.kp = 1.0f;
    settings.ki = 2.0f;
    settings.kd = 0.05f;
    take(&before, &controller, sizeof controller);
    settings.lambda = 0.7;
    expect("another order", fvi_pid_set(&controller, &settings), FVI_STATUS_OUT_OF_RANGE);
    settings.lambda = 0.8;
    settings.rate_limit = not_a_number;
    expect("rate limit", fvi_pid_set(&controller, &settings), FVI_STATUS_NOT_FINITE);
    settings.rate_limit = 10.0f;
    expect("no settings", fvi_pid_set(&controller, NULL), FVI_STATUS_NULL);
    expect_unchanged("controller", &before);
    expect("set", fvi_pid_set(&controller, &settings), FVI_STATUS_OK);
    for (int k = 0; k < 20; ++k) {
        float last = output;
        expect("tick", fvi_pid_tick(&controller, 5.0f, plant, &output), FVI_STATUS_OK);
        expect_that("the new limit holds", output <= settings.limits[1]);
        expect_that("the new rate holds", k == 0 || (output - last < 0.1001f && last - output < 0.1001f));
        note(output);
    }
    expect("save", fvi_pid_save(&controller, saved, sizeof saved, &written), FVI_STATUS_OK);
    expect("tick", fvi_pid_tick(&controller, 0.0f, plant, &expected), FVI_STATUS_OK);
    expect("reset", fvi_pid_reset(&controller), FVI_STATUS_OK);
    expect("cut off", fvi_pid_restore(&controller, saved, written - 4), FVI_STATUS_WRONG_STATE);
    expect("restore", fvi_pid_restore(&controller, saved, written), FVI_STATUS_OK);
    expect("tick", fvi_pid_tick(&controller, 0.0f, plant, &output), FVI_STATUS_OK);
    expect_that("the same bits after a restart", output == expected);
}

/* I of order 1 in whole numbers: a sum in units of 2^-16 counts of the output. */
static void check_fixed_controller(void) {
    static const FviFixedGain head[] = {{1 << 30, 20}, {1 << 30, 20}};        /* 2^10 for 2^-5 counts: 1/2 a count each */
    static const FviFixedTerm terms[] = {{{0, 0}, {1 << 30, 30}, 10}};
    FviFixedLaw law = {
        .integral_head = head, .integral_head_count = 2, .integral_terms = terms, .integral_terms_count = 1,
        .limits = {INT64_C(-100) * 65536, INT64_C(100) * 65536}, .stride = INT64_MAX,
        .derivative_of = FVI_PID_FROM_REST, .anti_windup = FVI_PID_CONDITIONAL, .windup = {1 << 30, 40},
    };
    FviFixedPid fixed = {{0}};
    int64_t numbers[2];
    int32_t output = 0;
    expect("fixed tick before init", fvi_fixed_pid_tick(&fixed, 1, 0, &output), FVI_STATUS_NOT_INITIALISED);
    expect("fixed without a law", fvi_fixed_pid_init(&fixed, NULL, numbers, 2), FVI_STATUS_NULL);
    expect("fixed of another size", fvi_fixed_pid_init(&fixed, &law, numbers, 1), FVI_STATUS_WRONG_SIZE);
    law.anti_windup = 9;
    expect("fixed unknown constant", fvi_fixed_pid_init(&fixed, &law, numbers, 2), FVI_STATUS_OUT_OF_RANGE);
    law.anti_windup = FVI_PID_CONDITIONAL;
    expect("fixed init", fvi_fixed_pid_init(&fixed, &law, numbers, 2), FVI_STATUS_OK);
    for (int32_t k = 1; k <= 20; ++k) {
        expect("fixed tick", fvi_fixed_pid_tick(&fixed, 30, 10, &output), FVI_STATUS_OK);
        expect_that("the integral is a sum within limits", output == (k < 10 ? 10 * k : 100));
        note((float)output);
    }
    expect("fixed tick", fvi_fixed_pid_tick(&fixed, 0, 20, &output), FVI_STATUS_OK);
    expect_that("it comes back at once", output == 90);
    expect("fixed extremes", fvi_fixed_pid_tick(&fixed, INT32_MAX, INT32_MIN, &output), FVI_STATUS_OK);
    expect_that("and saturates", output == 100);
    expect("fixed reset", fvi_fixed_pid_reset(&fixed), FVI_STATUS_OK);
    expect("fixed tick", fvi_fixed_pid_tick(&fixed, 0, 20, &output), FVI_STATUS_OK);
    expect_that("from the start", output == -10);
}

static void tell_hash(void) {
    char text[] = "results 00000000\n";
    for (int digit = 0; digit < 8; ++digit) {
        text[8 + digit] = "0123456789abcdef"[hash >> (28 - 4 * digit) & 15u];
    }
    tell(text);
}

int check_interface(void (*say)(const char *text)) {
    tell = say;
    check_weights();
    check_ring();
    check_exponential_sum();
    check_table();
    check_increments();
    check_endless();
    check_scale();
    check_ticks();
    check_trajectories();
    check_trajectories_at_the_node();
    check_bad_steppers();
    check_failed_steps();
    check_restarts();
    check_restarted_operators();
    check_controller();
    check_plain_controllers();
    check_fixed_controller();
    for (int status = 0; status < STATUSES; ++status) {
        if (!reached[status]) {
            fail(fvi_status_text(status), "never returned");
        }
    }
    expect_that("unknown statuses have a text", fvi_status_text(-1) != NULL && fvi_status_text(STATUSES) == fvi_status_text(-1));
    expect_that("known statuses have their own", fvi_status_text(STATUSES - 1) != fvi_status_text(STATUSES));
    tell_hash();
    tell(failures ? "the interface FAILED\n" : "every status reached, every refused call without effect\n");
    return failures;
}
