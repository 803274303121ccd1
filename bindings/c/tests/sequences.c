/* Random sequences of calls: CALLS of them (default 20000) from SEED (default 1), with whatever the header allows to be wrong.
 *
 * Pointers are NULL or misaligned now and then, numbers anything, sizes zero or impossible, callbacks lie, objects are used before they
 * are set up and set up again while in use. Two things must hold: a call that returns anything but FVI_STATUS_OK has changed nothing,
 * object, buffer, and results alike (but for what the header excepts); and what a call that returns FVI_STATUS_OK has written is finite. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fvi.h"
#include "half_derivative.h"

enum { OPERATORS = 3, STEPPERS = 3, CONTROLLERS = 2, CAPACITY = 12, MOST = 6, STATUSES = 13, CALLS = 13 };
enum { NUMBERS = HALF_DERIVATIVE_NUMBERS(MOST) };

/* Everything a call may write to, so that one comparison sees every change. */
static struct {
    FviOperator operators[OPERATORS];
    float operator_buffers[OPERATORS][HALF_DERIVATIVE_NUMBERS(1)];
    union {
        FviStepper1 one;
        FviStepper2 two;
        FviStepper3 three;
        FviStepper4 four;
        FviStepper5 five;
        FviStepper6 six;
    } steppers[STEPPERS];
    float stepper_buffers[STEPPERS][NUMBERS];
    FviPid controllers[CONTROLLERS];
    /* Of the integral, of the derivative. */
    float controller_buffers[CONTROLLERS][2][CAPACITY];
    FviMemory memory;
    FviStepper *address;
    float weights[CAPACITY + 1], result, results[2], position[MOST], momentum[MOST];
    uint64_t steps;
    /* The largest state is a full buffer and what stands around it, a few hundred bytes. */
    uint8_t saved[3][NUMBERS * sizeof(float) + 1024];
    size_t written[3];
} world, before;

static const char *const names[CALLS] = {"weights", "operator init", "operator push", "operator clear", "stepper init", "stepper step and state",
    "operator save and restore", "stepper save and restore", "operator peek", "operator push two", "memory scale", "controller init",
    "controller tick, gains and hand"};
static unsigned long reached[CALLS][STATUSES], made;
static uint64_t seed;

/* --- Chance ------------------------------------------------------------------------------------------------------------- */

static uint64_t state;

static uint32_t below(uint32_t bound) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    uint32_t high = (uint32_t)(state >> 32);
    return (uint32_t)(((uint64_t)high * bound) >> 32);
}

static int rarely(void) {
    return below(40) == 0;
}

/* A number in [-1, 1], or now and then one that nobody expects. */
static float number(void) {
    static const float strange[] = {0.0f, -0.0f, 1e-45f, 1e-30f, 3e38f, -3e38f, 1e19f, -1.0f, 2.0f, INFINITY, -INFINITY, NAN};
    if (rarely()) {
        return strange[below(sizeof strange / sizeof *strange)];
    }
    return (float)below(1u << 24) / 8388608.0f - 1.0f;
}

/* A positive one. */
static float positive(void) {
    float drawn = number();
    return rarely() ? drawn : drawn < 0.0f ? -drawn : drawn;
}

/* The pointer, NULL, or one byte further; what lies there is never touched by a call that keeps its word. */
static void *pointer(void *good) {
    switch (below(60)) {
    case 0: return NULL;
    case 1: return (char *)good + 1;
    default: return good;
    }
}

static size_t size(size_t good) {
    static const size_t strange[] = {0, SIZE_MAX, SIZE_MAX / 4, SIZE_MAX / 2 + 1};
    return rarely() ? strange[below(4)] : rarely() ? below((uint32_t)good + 1) : good;
}

/* --- Verdict ------------------------------------------------------------------------------------------------------------ */

static void stop(int call, const char *why) {
    fprintf(stderr, "FAILED: call %lu of seed %llu, %s: %s\n", made, (unsigned long long)seed, names[call], why);
    exit(1);
}

static void expect_finite(int call, const float *numbers, size_t count) {
    for (size_t i = 0; i < count; ++i) {
        if (!isfinite(numbers[i])) {
            stop(call, "gives a number that is not finite");
        }
    }
}

/* The buffer of an exponential sum, or those of a controller, which a refused call that sets up the object may empty. */
static float *emptied;
static size_t emptied_size;

static void may_empty(const FviMemory *memory, float *buffer, size_t size) {
    emptied = (memory->kind & ~(uint32_t)(FVI_ON_INCREMENTS | FVI_FORGET_PAST_HORIZON)) == FVI_EXPONENTIAL_SUM ? buffer : NULL;
    emptied_size = size;
}

static void remember(void) {
    memcpy(&before, &world, sizeof world);
}

/* Counts the status of a call; one that is refused must have left the world as it was. */
static int is_done(int call, int status) {
    made += 1;
    if (status != FVI_STATUS_OK && emptied != NULL) {
        memcpy(emptied, (char *)&before + ((char *)emptied - (char *)&world), emptied_size);
    }
    emptied = NULL;
    if (status < 0 || status >= STATUSES || fvi_status_text(status) == NULL) {
        stop(call, "returns no status");
    }
    reached[call][status] += 1;
    if (status != FVI_STATUS_OK && memcmp(&before, &world, sizeof world) != 0) {
        stop(call, fvi_status_text(status));
    }
    return status == FVI_STATUS_OK;
}

/* --- Calls -------------------------------------------------------------------------------------------------------------- */

static float kernel[CAPACITY + 1];

static FviMemory memory(int channels, float *buffer, size_t room) {
    FviMemory drawn = {0};
    drawn.kind = (rarely() ? below(9) : below(3)) | (below(3) == 0 ? FVI_ON_INCREMENTS : 0) | (below(8) == 0 ? FVI_FORGET_PAST_HORIZON : 0);
    drawn.scale = rarely() ? number() : 1.0f;
    drawn.buffer = pointer(buffer);
    if ((drawn.kind & ~(uint32_t)(FVI_ON_INCREMENTS | FVI_FORGET_PAST_HORIZON)) == FVI_EXPONENTIAL_SUM) {
        drawn.weights = pointer((void *)(uintptr_t)half_derivative_head);
        drawn.weight_count = size(HALF_DERIVATIVE_HEAD);
        drawn.exponentials = pointer((void *)(uintptr_t)half_derivative_exponentials);
        drawn.exponential_count = size(HALF_DERIVATIVE_EXPONENTIALS);
        drawn.slow_blocks = rarely() ? size(99) : HALF_DERIVATIVE_SLOW_BLOCKS;
        drawn.far_blocks = rarely() ? size(99) : HALF_DERIVATIVE_FAR_BLOCKS;
        drawn.step_size = rarely() ? (double)number() : HALF_DERIVATIVE_STEP;
        drawn.horizon = rarely() ? size(30) : HALF_DERIVATIVE_HORIZON;
        drawn.buffer_count = size((size_t)HALF_DERIVATIVE_NUMBERS(channels));
    } else {
        drawn.weights = pointer(kernel);
        drawn.weight_count = size(CAPACITY);
        drawn.buffer_count = size((size_t)channels * (1 + below(CAPACITY)));
    }
    /* No count that a buffer of this size could be taken for and that it does not have. */
    if (drawn.buffer_count > room && drawn.buffer_count < SIZE_MAX / 4) {
        drawn.buffer_count = room;
    }
    return drawn;
}

static void make_weights(void) {
    size_t count = below(CAPACITY + 1);
    double step_size = rarely() ? (double)number() : 0.25, exponent = rarely() ? 3.0 * (double)number() : (double)number();
    remember();
    FviStatus (*const weights)(uint32_t, double, double, float *, size_t) = below(2) ? fvi_weights_bdf : fvi_increment_weights_bdf;
    int status = weights(rarely() ? below(UINT32_MAX) : 1 + below(6), exponent, step_size, pointer(world.weights),
        rarely() ? SIZE_MAX : count);
    if (is_done(0, status) && fabs(step_size) > 1e-9) {
        expect_finite(0, world.weights, count);
    }
}

static void init_operator(void) {
    uint32_t index = below(OPERATORS);
    FviMemory drawn = memory(1, world.operator_buffers[index], sizeof world.operator_buffers[index] / sizeof(float));
    remember();
    may_empty(&drawn, world.operator_buffers[index], sizeof world.operator_buffers[index]);
    is_done(1, fvi_operator_init(pointer(&world.operators[index]), pointer(&drawn), rarely() ? below(9) : below(3), number()));
}

static void push(void) {
    FviOperator *operation = &world.operators[below(OPERATORS)];
    remember();
    if (is_done(2, fvi_operator_push(pointer(operation), number(), pointer(&world.result)))) {
        expect_finite(2, &world.result, 1);
    }
}

/* What a push would give, and nothing else. */
static void peek(void) {
    FviOperator *operation = &world.operators[below(OPERATORS)];
    float sample = number();
    remember();
    if (is_done(8, fvi_operator_peek(pointer(operation), sample, pointer(&world.result)))) {
        float peeked = world.result;
        expect_finite(8, &peeked, 1);
        world.result = before.result;
        if (memcmp(&before, &world, sizeof world) != 0) {
            stop(8, "changes the operator");
        }
        if (fvi_operator_push(operation, sample, &world.result) == FVI_STATUS_OK && memcmp(&peeked, &world.result, sizeof peeked) != 0) {
            stop(8, "gives another number than a push");
        }
    }
}

static void push_two(void) {
    float samples[2] = {number(), number()};
    remember();
    if (is_done(9, fvi_operator_push_two(pointer(&world.operators[below(OPERATORS)]), pointer(&world.operators[below(OPERATORS)]),
            pointer(samples), pointer(world.results)))) {
        expect_finite(9, world.results, 2);
    }
}

static void scale(void) {
    world.memory = memory(1, world.operator_buffers[0], sizeof world.operator_buffers[0] / sizeof(float));
    double step_size = rarely() ? (double)number() : below(2) ? HALF_DERIVATIVE_STEP : 0.25;
    remember();
    if (is_done(10, fvi_memory_scale_bdf(pointer(&world.memory), rarely() ? below(9) : 1, rarely() ? 3.0 * (double)number() : 0.5, step_size))) {
        expect_finite(10, &world.memory.scale, 1);
    }
}

static float integral_weights[CAPACITY], derivative_weights[CAPACITY];

static FviMemory controller_memory(int index, int part) {
    FviMemory drawn = {0};
    drawn.kind = rarely() ? below(9) : below(8) == 0 ? FVI_FULL_MEMORY : FVI_SHORT_MEMORY;
    drawn.scale = rarely() ? number() : 1.0f;
    drawn.weights = pointer(rarely() || part == 0 ? integral_weights : derivative_weights);
    drawn.weight_count = rarely() ? below(CAPACITY + 1) : CAPACITY;
    drawn.buffer = pointer(world.controller_buffers[index][part]);
    drawn.buffer_count = rarely() ? below(CAPACITY + 1) : CAPACITY;
    return drawn;
}

static FviPidSettings controller_settings(void) {
    float bound = 3.0f * positive();
    return (FviPidSettings){
        .sample = rarely() ? (double)number() : 0.01,
        .lambda = rarely() ? 3.0 * (double)number() : 0.8,
        .mu = rarely() ? 3.0 * (double)number() : 0.6,
        .filter_time = below(2) ? 0.0 : (double)positive(),
        .filter_order = rarely() ? (double)number() : 0.0,
        .tracking_time = below(2) ? 0.1 : (double)number(),
        .kp = number(),
        .ki = number(),
        .kd = number(),
        .filter_ratio = below(2) ? 10.0f : number(),
        .setpoint_weights = {number(), below(2) ? 0.0f : number()},
        .limits = {below(3) ? -bound : number(), below(3) ? bound : number()},
        .rate_limit = below(2) ? 0.0f : 100.0f * positive(),
        .form = rarely() ? below(5) : below(4) == 0,
        .derivative_of = rarely() ? below(5) : below(3),
        .anti_windup = rarely() ? below(5) : below(3),
        .bumpless = rarely() ? below(5) : below(3),
    };
}

static void init_controller(void) {
    int index = (int)below(CONTROLLERS);
    FviMemory integral = controller_memory(index, 0), derivative = controller_memory(index, 1);
    FviPidSettings settings = controller_settings();
    void *const given[5] = {pointer(&world.controllers[index]), pointer(&settings), below(8) ? pointer(&integral) : NULL,
        below(8) ? pointer(&derivative) : NULL, NULL};
    remember();
    emptied = world.controller_buffers[index][0];
    emptied_size = sizeof world.controller_buffers[index];
    is_done(11, fvi_pid_init(given[0], given[1], given[2], given[3], given[4]));
}

static size_t capacity(void);
static size_t kept(size_t written);
static void damage(int index);

static void control(void) {
    FviPid *controller = pointer(&world.controllers[below(CONTROLLERS)]);
    FviPidInputs inputs = {
        .setpoint = number(),
        .measured = number(),
        .rate = number(),
        .feed_forward = below(2) ? 0.0f : number(),
        .actuator = rarely() ? below(9) : below(3),
        .applied = number(),
    };
    FviPidSettings settings = controller_settings();
    float term;
    FviStatus status;
    remember();
    switch (below(18)) {
    case 0: status = fvi_pid_manual(controller, number()); break;
    case 1: status = fvi_pid_automatic(controller); break;
    case 2: status = fvi_pid_set_gains(controller, number(), number(), number()); break;
    case 3: status = fvi_pid_reset(controller); break;
    case 16: status = fvi_pid_set(controller, pointer(&settings)); break;
    case 17: status = fvi_pid_state(controller, below(2) ? NULL : &term, pointer(&world.result)); break;
    case 4:
        is_done(12, fvi_pid_save(controller, pointer(world.saved[2]), capacity(), pointer(&world.written[2])));
        damage(2);
        remember();
        status = fvi_pid_restore(controller, pointer(world.saved[2]), kept(world.written[2]));
        break;
    case 5: case 6: case 7: status = fvi_pid_tick(controller, number(), number(), pointer(&world.result)); break;
    default: status = fvi_pid_tick_with(controller, pointer(&inputs), pointer(&world.result)); break;
    }
    if (is_done(12, status)) {
        expect_finite(12, &world.result, 1);
    }
}

static void clear(void) {
    remember();
    is_done(3, fvi_operator_clear(pointer(&world.operators[below(OPERATORS)])));
}

/* What the callbacks of a stepper are told: springs that harden, whether they lie now and then, and a factor of the Hessian. */
typedef struct {
    int coordinates;
    float stiffness, hardening;
    int lies;
    float factor;
} Springs;

/* Of each stepper, those in use and those of the next attempt to set it up. */
static Springs springs[STEPPERS][2];
static int in_use[STEPPERS];

static void gradient(void *context, const float *position, float *result) {
    const Springs *of = context;
    for (int i = 0; i < of->coordinates; ++i) {
        result[i] = of->lies && rarely() ? number() : of->stiffness * position[i] + of->hardening * position[i] * position[i] * position[i];
    }
}

static void hessian(void *context, const float *position, float *result) {
    const Springs *of = context;
    int n = of->coordinates;
    for (int i = 0; i < n * n; ++i) {
        float q = position[i / n];
        result[i] = of->lies && rarely() ? number() : i / n == i % n ? of->factor * (of->stiffness + 3.0f * of->hardening * q * q) : 0.0f;
    }
}

static void force(void *context, float time, const float *position, float *result) {
    const Springs *of = context;
    for (int i = 0; i < of->coordinates; ++i) {
        result[i] = of->lies && rarely() ? number() : time < 1.0f ? 1.0f : position[i] * 0.01f;
    }
}

#define INIT(name) \
    static int name(void *storage, const FviSystem *system, FviStepper **stepper) { \
        return fvi_stepper_##name(storage, system, stepper); \
    }
INIT(init_1)
INIT(init_2)
INIT(init_3)
INIT(init_4)
INIT(init_5)
INIT(init_6)
INIT(init_at_node_1)
INIT(init_at_node_2)
INIT(init_at_node_3)
INIT(init_at_node_4)
INIT(init_at_node_5)
INIT(init_at_node_6)

static void init_stepper(void) {
    uint32_t index = below(STEPPERS);
    int n = 1 + (int)below(MOST);
    float mass[MOST * MOST] = {0}, damping[MOST * MOST] = {0}, position[MOST], momentum[MOST];
    for (int i = 0; i < n; ++i) {
        position[i] = number();
        momentum[i] = number();
        mass[i * n + i] = 0.5f + positive();
        damping[i * n + i] = positive();
    }
    if (n > 1 && below(4) == 0) {
        damping[1] = damping[n] = 0.1f * number();
        mass[1] = mass[n] = rarely() ? number() : 0.1f;
        mass[n] = rarely() ? number() : mass[n];
    }
    Springs *drawn_springs = &springs[index][!in_use[index]];
    *drawn_springs = (Springs){n, 9.0f * positive(), positive(), below(3) == 0, below(8) == 0 ? 5.0f * number() : 1.0f};
    FviMemory drawn = memory(n, world.stepper_buffers[index], NUMBERS);
    FviSystem system = {
        .mass = pointer(mass),
        .damping = pointer(damping),
        .damping_order = rarely() ? 3.0f * number() : 0.5f,
        .derivative = rarely() ? below(9) : below(2),
        .memory = pointer(&drawn),
        .step_size = rarely() ? number() : 0.25f,
        .kappa = rarely() ? number() : (float)below(5) / 4.0f,
        .position = pointer(position),
        .momentum = pointer(momentum),
        .gradient = rarely() ? NULL : gradient,
        .hessian = rarely() ? NULL : hessian,
        .force = below(2) ? NULL : force,
        .context = drawn_springs,
    };
    void *storage = pointer(&world.steppers[index]);
    const FviSystem *passed = pointer(&system);
    FviStepper **address = pointer(&world.address);
    remember();
    may_empty(&drawn, world.stepper_buffers[index], sizeof world.stepper_buffers[index]);
    static int (*const inits[2][MOST])(void *, const FviSystem *, FviStepper **) = {
        {init_1, init_2, init_3, init_4, init_5, init_6},
        {init_at_node_1, init_at_node_2, init_at_node_3, init_at_node_4, init_at_node_5, init_at_node_6},
    };
    int status = inits[below(2)][n - 1](storage, passed, address);
    if (is_done(4, status)) {
        in_use[index] = !in_use[index];
        if ((void *)world.address != storage) {
            stop(4, "gives another address");
        }
    }
}

static void step(void) {
    uint32_t index = below(STEPPERS);
    float input[MOST];
    for (int i = 0; i < MOST; ++i) {
        input[i] = number();
    }
    remember();
    is_done(5, fvi_stepper_step(pointer(&world.steppers[index]), below(2) ? NULL : pointer(input)));
    remember();
    if (is_done(5, fvi_stepper_state(pointer(&world.steppers[index]), pointer(world.position), pointer(world.momentum),
            below(2) ? NULL : pointer(&world.steps)))) {
        expect_finite(5, world.position, MOST);
        expect_finite(5, world.momentum, MOST);
    }
}

static size_t capacity(void) {
    return below(4) == 0 ? below(300) : rarely() ? SIZE_MAX : sizeof world.saved[0];
}

/* A state is restored as it was saved, or cut off; to the same object or to any other, which refuses what is not its own. */
static size_t kept(size_t written) {
    return below(8) == 0 ? below((uint32_t)written + 1) : written;
}

/* A bit of it may have changed while it was stored. What such a state leads to is anything, but finite. */
static void damage(int index) {
    if (below(10) == 0 && world.written[index] > 0) {
        world.saved[index][below((uint32_t)world.written[index])] ^= (uint8_t)(1u << below(8));
    }
}

static void save_and_restore_operator(void) {
    remember();
    is_done(6, fvi_operator_save(pointer(&world.operators[below(OPERATORS)]), pointer(world.saved[0]), capacity(), pointer(&world.written[0])));
    damage(0);
    remember();
    is_done(6, fvi_operator_restore(pointer(&world.operators[below(OPERATORS)]), pointer(world.saved[0]), kept(world.written[0])));
}

static void save_and_restore_stepper(void) {
    static FviStatus (*const saves[MOST])(const FviStepper *, uint8_t *, size_t, size_t *) = {
        fvi_stepper_save_1, fvi_stepper_save_2, fvi_stepper_save_3, fvi_stepper_save_4, fvi_stepper_save_5, fvi_stepper_save_6};
    static FviStatus (*const restores[MOST])(FviStepper *, const uint8_t *, size_t) = {fvi_stepper_restore_1,
        fvi_stepper_restore_2, fvi_stepper_restore_3, fvi_stepper_restore_4, fvi_stepper_restore_5, fvi_stepper_restore_6};
    uint32_t from = below(STEPPERS), to = below(2) ? from : below(STEPPERS);
    int n = springs[from][in_use[from]].coordinates - 1;
    n = n < 0 || rarely() ? (int)below(MOST) : n;
    remember();
    is_done(7, saves[n](pointer(&world.steppers[from]), pointer(world.saved[1]), capacity(), pointer(&world.written[1])));
    damage(1);
    remember();
    is_done(7, restores[rarely() ? (int)below(MOST) : n](pointer(&world.steppers[to]), pointer(world.saved[1]), kept(world.written[1])));
}

int main(int count, char **arguments) {
    unsigned long calls = count > 1 ? strtoul(arguments[1], NULL, 10) : 20000;
    seed = count > 2 ? strtoull(arguments[2], NULL, 10) : 1;
    state = seed;
    for (int i = 0; i <= CAPACITY; ++i) {
        kernel[i] = i == 0 ? 2.0f : -1.0f / (float)(i * i);
    }
    if (fvi_weights_bdf(1, -0.8, 0.01, integral_weights, CAPACITY) != FVI_STATUS_OK
        || fvi_weights_bdf(1, 0.6, 0.01, derivative_weights, CAPACITY) != FVI_STATUS_OK) {
        return 1;
    }
    while (made < calls) {
        switch (below(28)) {
        case 0: make_weights(); break;
        case 1: init_operator(); break;
        case 2: clear(); break;
        case 3: init_stepper(); break;
        case 4: case 5: case 6: case 7: case 8: push(); break;
        case 9: save_and_restore_operator(); break;
        case 10: case 11: save_and_restore_stepper(); break;
        case 12: peek(); break;
        case 13: push_two(); break;
        case 14: scale(); break;
        case 15: init_controller(); break;
        case 16: case 17: case 18: case 19: case 20: control(); break;
        default: step(); break;
        }
    }
    printf("C calls: %lu from seed %llu\n", made, (unsigned long long)seed);
    for (int call = 0; call < CALLS; ++call) {
        unsigned long all = 0;
        for (int status = 0; status < STATUSES; ++status) {
            all += reached[call][status];
        }
        printf("  %s: %lu, %lu of them done\n", names[call], all, reached[call][FVI_STATUS_OK]);
    }
    for (int status = 0; status < STATUSES; ++status) {
        unsigned long all = 0;
        for (int call = 0; call < CALLS; ++call) {
            all += reached[call][status];
        }
        if (all == 0 && made >= 20000) {
            printf("FAILED: the status \"%s\" was never reached\n", fvi_status_text(status));
            return 1;
        }
    }
    return 0;
}
