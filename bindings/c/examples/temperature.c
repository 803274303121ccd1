/* A fractional PID controller holds the temperature of an oven: 60 s time constant, heater between 0 and 1.
 *
 * u = 2 (r - y) + 0.05 I^0.9 (r - y) - 5 D^0.4 y, every second; the integral's memory is wound back at the limits. */
#include "fvi.h"
#include <math.h>
#include <stdio.h>

enum { TICKS = 1200 };

static float integral_weights[TICKS + 1], integral_ring[TICKS + 1];
static float derivative_weights[TICKS + 1], derivative_ring[TICKS + 1];
static FviPid controller;

int main(void) {
    const double sample = 1.0;
    FviPidSettings settings = {.sample = sample, .lambda = 0.9, .mu = 0.4, .kp = 2.0f, .ki = 0.05f, .kd = 5.0f,
                               .setpoint_weights = {1.0f, 0.0f}, .limits = {0.0f, 1.0f},
                               .anti_windup = FVI_PID_BACK_CALCULATION, .tracking_time = 10.0};
    enum FviStatus status = fvi_weights_bdf(1, -0.9, sample, integral_weights, TICKS + 1);
    if (status == FVI_STATUS_OK) status = fvi_weights_bdf(1, 0.4, sample, derivative_weights, TICKS + 1);
    FviMemory integral = {.kind = FVI_FULL_MEMORY, .scale = 1.0f, .weights = integral_weights,
                          .weight_count = TICKS + 1, .buffer = integral_ring, .buffer_count = TICKS + 1};
    FviMemory derivative = {.kind = FVI_FULL_MEMORY, .scale = 1.0f, .weights = derivative_weights,
                            .weight_count = TICKS + 1, .buffer = derivative_ring, .buffer_count = TICKS + 1};
    if (status == FVI_STATUS_OK) status = fvi_pid_init(&controller, &settings, &integral, &derivative, NULL);
    float temperature = 0.0f, heater = 0.0f;
    for (int k = 0; k < TICKS && status == FVI_STATUS_OK; ++k) {
        status = fvi_pid_tick(&controller, 0.6f, temperature, &heater);
        if (k % 200 == 0) printf("t = %4d s: %.3f, heater %.3f\n", k, (double)temperature, (double)heater);
        temperature += (1.0f - expf(-1.0f / 60.0f)) * (heater - temperature);
    }
    printf("t = %4d s: %.3f, heater %.3f\n", TICKS, (double)temperature, (double)heater);
    if (status != FVI_STATUS_OK) fprintf(stderr, "temperature: %s\n", fvi_status_text(status));
    return status != FVI_STATUS_OK || fabsf(temperature - 0.6f) > 0.01f;
}
