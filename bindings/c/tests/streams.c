/* Checks of the C interface for streams on a host: every status, that refused calls change nothing, sums against their definition in both
 * precisions, exchange, saved states, and that the calls of a stream's thread neither allocate nor enter the kernel.
 *
 * Linked with -Wl,--wrap=malloc,... the program counts the calls of the allocator and of the kernel that the library makes. */
#include "fvi_streams.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { STATUSES = 17, LENGTH = 3000, SAMPLES = 12000 };

static int failures;
static int reached[STATUSES];

static void expect(const char *what, int status, int expected) {
    reached[status] = 1;
    if (status != expected) {
        failures += 1;
        printf("FAILED: %s: %s\n", what, fvi_stream_status_text(status));
    }
}

static void expect_that(const char *what, int condition) {
    if (!condition) {
        failures += 1;
        printf("FAILED: %s\n", what);
    }
}

/* --- Calls that may wait ---------------------------------------------------------------------------------------------- */

static unsigned long long calls;

#if defined(CHECK_WITH_COUNTS)
void *__real_malloc(size_t size);
void *__real_calloc(size_t count, size_t size);
void *__real_realloc(void *old, size_t size);
int __real_posix_memalign(void **place, size_t alignment, size_t size);
void *__real_aligned_alloc(size_t alignment, size_t size);
void __real_free(void *old);
int __real_pthread_mutex_lock(void *mutex);
long __real_syscall(long number, long a, long b, long c, long d, long e, long f);

void *__wrap_malloc(size_t size);
void *__wrap_calloc(size_t count, size_t size);
void *__wrap_realloc(void *old, size_t size);
int __wrap_posix_memalign(void **place, size_t alignment, size_t size);
void *__wrap_aligned_alloc(size_t alignment, size_t size);
void __wrap_free(void *old);
int __wrap_pthread_mutex_lock(void *mutex);
long __wrap_syscall(long number, long a, long b, long c, long d, long e, long f);

void *__wrap_malloc(size_t size) {
    calls += 1;
    return __real_malloc(size);
}
void *__wrap_calloc(size_t count, size_t size) {
    calls += 1;
    return __real_calloc(count, size);
}
void *__wrap_realloc(void *old, size_t size) {
    calls += 1;
    return __real_realloc(old, size);
}
int __wrap_posix_memalign(void **place, size_t alignment, size_t size) {
    calls += 1;
    return __real_posix_memalign(place, alignment, size);
}
void *__wrap_aligned_alloc(size_t alignment, size_t size) {
    calls += 1;
    return __real_aligned_alloc(alignment, size);
}
void __wrap_free(void *old) {
    calls += 1;
    __real_free(old);
}
int __wrap_pthread_mutex_lock(void *mutex) {
    calls += 1;
    return __real_pthread_mutex_lock(mutex);
}
/* With which Rust's locks wait and wake. */
long __wrap_syscall(long number, long a, long b, long c, long d, long e, long f) {
    calls += 1;
    return __real_syscall(number, a, b, c, d, e, f);
}
#endif

/* --- Signals ---------------------------------------------------------------------------------------------------------- */

static float noise_f32(void) {
    static uint32_t state = 1;
    state = state * 1664525u + 1013904223u;
    return (float)state / 4294967296.0f - 0.5f;
}

static double noise_f64(void) {
    return (double)noise_f32();
}

/* Everything that is the same in both precisions, once for each. */
#define NUMBER float
#define OF(name) name##_f32
#define Of(Name) Name##F32
#define UNIT 1.2e-7
#include "streams_of_precision.h"
#undef NUMBER
#undef OF
#undef Of
#undef UNIT

#define NUMBER double
#define OF(name) name##_f64
#define Of(Name) Name##F64
#define UNIT 2.2e-16
#include "streams_of_precision.h"

int main(void) {
    check_sums_f32();
    check_sums_f64();
    check_in_place_f32();
    check_in_place_f64();
    check_exchange_f32();
    check_exchange_f64();
    check_states_f32();
    check_states_f64();
    check_refused_f32();
    check_refused_f64();

    /* A state of one precision in a convolver of the other. */
    float single[] = {1.0f, 0.5f};
    double twice[] = {1.0, 0.5};
    FviResponseF32 of_single = {single, 2};
    FviResponseF64 of_double = {twice, 2};
    FviStream stream = {0, 0, 0};
    FviConvolverF32 *a = NULL;
    FviConvolverF64 *b = NULL;
    unsigned char bytes[4096];
    size_t written = 0;
    expect("single", fvi_convolver_new_f32(&of_single, 1, 1, &stream, &a), FVI_STREAM_STATUS_OK);
    expect("double", fvi_convolver_new_f64(&of_double, 1, 1, &stream, &b), FVI_STREAM_STATUS_OK);
    expect("save", fvi_convolver_save_f32(a, bytes, sizeof bytes, &written), FVI_STREAM_STATUS_OK);
    expect("state of another precision", fvi_convolver_restore_f64(b, bytes, written), FVI_STREAM_STATUS_WRONG_STATE);
    fvi_convolver_free_f32(a);
    fvi_convolver_free_f64(b);

#if defined(CHECK_WITH_COUNTS)
    expect_that("calls are counted", calls > 100);
#endif
    for (int status = 0; status < STATUSES; ++status) {
        if (!reached[status]) {
            failures += 1;
            printf("FAILED: no call has returned: %s\n", fvi_stream_status_text(status));
        }
        for (int other = 0; other < status; ++other) {
            expect_that("statuses have texts of their own", strcmp(fvi_stream_status_text(status), fvi_stream_status_text(other)) != 0);
        }
    }
    expect_that("other statuses have a text", strcmp(fvi_stream_status_text(STATUSES), "unknown status") == 0);
    expect_that("negative statuses have a text", strcmp(fvi_stream_status_text(-1), "unknown status") == 0);
    printf("streams: %s\n", failures ? "failed" : "as they should be");
    return failures != 0;
}
