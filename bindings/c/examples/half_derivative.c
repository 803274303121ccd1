/* The half derivative of a ramp, sample by sample, with the last 1000 samples in a ring.
 *
 * D^(1/2) t = 2 sqrt(t/pi). At t = 1 the ring still holds every sample; the error is that of first-order weights. */
#include "fvi.h"
#include <math.h>
#include <stdio.h>

enum { SAMPLES = 1001 };

static float weights[SAMPLES], ring[SAMPLES];
static FviOperator half_derivative;

int main(void) {
    const float step = 1e-3f;
    enum FviStatus status = fvi_weights_bdf(1, 0.5, (double)step, weights, SAMPLES);
    FviMemory memory = {.kind = FVI_FULL_MEMORY, .scale = 1.0f, .weights = weights, .weight_count = SAMPLES,
                        .buffer = ring, .buffer_count = SAMPLES};
    if (status == FVI_STATUS_OK) status = fvi_operator_init(&half_derivative, &memory, FVI_RIEMANN_LIOUVILLE, 0.0f);
    for (int k = 0; k < SAMPLES && status == FVI_STATUS_OK; ++k) {
        float t = (float)k * step, derivative;
        status = fvi_operator_push(&half_derivative, t, &derivative);
        if (k > 0 && k % 250 == 0) {
            printf("t = %.2f: %.4f, exact %.4f\n", (double)t, (double)derivative, 2.0 * sqrt((double)t / 3.14159265358979));
        }
    }
    if (status != FVI_STATUS_OK) fprintf(stderr, "half_derivative: %s\n", fvi_status_text(status));
    return status != FVI_STATUS_OK;
}
