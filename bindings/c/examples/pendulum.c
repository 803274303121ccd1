/* A pendulum with a damper of order one half, stepped as a controller would step the model of its plant. */
#include "fvi.h"
#include <math.h>
#include <stdio.h>

enum { STEPS = 2000 };

static float weights[STEPS + 1], ring[STEPS + 1];
static FviStepper1 storage;

/* U = -9.81 cos q */
static void gradient(void *context, const float *position, float *result) {
    (void)context;
    result[0] = 9.81f * sinf(position[0]);
}

static void hessian(void *context, const float *position, float *result) {
    (void)context;
    result[0] = 9.81f * cosf(position[0]);
}

int main(void) {
    const float mass = 1.0f, damping = 0.3f, position = 2.0f, momentum = 0.0f, step = 0.01f;
    FviStepper *pendulum;
    enum FviStatus status = fvi_weights_bdf(2, 0.5, (double)step, weights, STEPS + 1);
    FviMemory memory = {.kind = FVI_FULL_MEMORY, .scale = 1.0f, .weights = weights, .weight_count = STEPS + 1,
                        .buffer = ring, .buffer_count = STEPS + 1};
    FviSystem system = {.mass = &mass, .damping = &damping, .damping_order = 0.5f, .derivative = FVI_CAPUTO,
                        .memory = &memory, .step_size = step, .kappa = 0.5f, .position = &position,
                        .momentum = &momentum, .gradient = gradient, .hessian = hessian};
    if (status == FVI_STATUS_OK) status = fvi_stepper_init_at_node_1(&storage, &system, &pendulum);
    for (int k = 1; k <= STEPS && status == FVI_STATUS_OK; ++k) {
        float q, p;
        status = fvi_stepper_step(pendulum, NULL);
        if (status == FVI_STATUS_OK && k % 500 == 0) {
            status = fvi_stepper_state(pendulum, &q, &p, NULL);
            printf("t = %2.0f: q = %+.4f, p = %+.4f\n", (double)(step * (float)k), (double)q, (double)p);
        }
    }
    if (status != FVI_STATUS_OK) fprintf(stderr, "pendulum: %s\n", fvi_status_text(status));
    return status != FVI_STATUS_OK;
}
