/* A response of ten seconds on a stream against the clock: blocks of 64 samples at 48 kHz, each of which must be done before the next
 * one comes. Other responses are prepared on a second thread and exchanged, without a lock.
 *
 *     real_time_stream 5
 *
 * The argument is the time to run in seconds. */
#define _POSIX_C_SOURCE 200809L
#include "fvi_streams.h"

#include <math.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { RATE = 48000, BLOCK = 64, LENGTH = 480000, FADE = 4800 };

static FviPreparerF32 *preparer;
/* One place goes to the stream, and comes back from it. */
static _Atomic(FviPreparedF32 *) ready, done;
static atomic_int at_end;

static void check(enum FviStreamStatus status) {
    if (status != FVI_STREAM_STATUS_OK) {
        fprintf(stderr, "real_time_stream: %s\n", fvi_stream_status_text((int32_t)status));
        exit(1);
    }
}

/* Ten seconds of noise that decays, different for each seed. */
static void make_room(float *room, uint32_t seed) {
    for (int n = 0; n < LENGTH; ++n) {
        seed = seed * 1664525u + 1013904223u;
        room[n] = ((float)seed / 4294967296.0f - 0.5f) * expf(-7.0f * (float)n / LENGTH);
    }
}

static void *prepare(void *argument) {
    static float room[LENGTH];
    for (uint32_t seed = 2; !atomic_load(&at_end); ++seed) {
        FviPreparedF32 *prepared = NULL, *old;
        make_room(room, seed);
        check(fvi_preparer_prepare_f32(preparer, &(FviResponseF32){room, LENGTH}, 1, 1, &prepared));
        atomic_store(&ready, prepared);
        while (!(old = atomic_exchange(&done, NULL)) && !atomic_load(&at_end)) nanosleep(&(struct timespec){0, 1000000}, NULL);
        fvi_prepared_free_f32(old);
    }
    return argument;
}

static double now(void) {
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return (double)time.tv_sec + 1e-9 * (double)time.tv_nsec;
}

int main(int count, char **arguments) {
    static float room[LENGTH];
    double seconds = count > 1 ? strtod(arguments[1], NULL) : 1.0;
    FviConvolverF32 *convolver = NULL;
    FviPreparedF32 *under_way = NULL;
    pthread_t other;
    make_room(room, 1);
    check(fvi_convolver_new_f32(&(FviResponseF32){room, LENGTH}, 1, 1, &(FviStream){.block = BLOCK}, &convolver));
    check(fvi_preparer_new_f32(convolver, &preparer));
    if (pthread_create(&other, NULL, prepare, NULL)) return 1;

    const double period = (double)BLOCK / RATE, begin = now();
    const int blocks = (int)(seconds / period);
    double sum = 0.0, longest = 0.0, loudest = 0.0;
    int late = 0, exchanges = 0;
    for (int block = 0; block < blocks; ++block) {
        double wait = begin + block * period - now();
        if (wait > 0.0) nanosleep(&(struct timespec){0, (long)(1e9 * wait)}, NULL);
        float samples[BLOCK];
        for (int k = 0; k < BLOCK; ++k) samples[k] = sinf(0.02f * (float)((block * BLOCK + k) % 314159));
        double before = now();
        /* The stream does not wait: what is not ready comes at a later block. Old responses are freed over there. */
        if (!under_way && (under_way = atomic_exchange(&ready, NULL))) {
            check(fvi_convolver_exchange_evenly_f32(convolver, under_way, FADE, NULL));
            exchanges += 1;
        }
        check(fvi_convolver_process_f32(convolver, (const float *const[]){samples}, (float *const[]){samples}, BLOCK));
        if (under_way && fvi_convolver_take_retired_f32(convolver, under_way) == FVI_STREAM_STATUS_OK) {
            atomic_store(&done, under_way);
            under_way = NULL;
        }
        double took = now() - before;
        sum += took;
        longest = fmax(longest, took);
        late += took > period;
        for (int k = 0; k < BLOCK; ++k) loudest = fmax(loudest, fabs((double)samples[k]));
    }
    atomic_store(&at_end, 1);
    pthread_join(other, NULL);
    FviConvolverFacts facts;
    check(fvi_convolver_facts_f32(convolver, &facts));
    printf("%d blocks of %.0f us, %d exchanges, loudest %.2f\n", blocks, 1e6 * period, exchanges, loudest);
    printf("mean %.2f us, longest %.2f us, %d later than the next block\n", 1e6 * sum / (blocks ? blocks : 1), 1e6 * longest, late);
    fvi_prepared_free_f32(under_way);
    fvi_prepared_free_f32(atomic_exchange(&ready, NULL));
    fvi_prepared_free_f32(atomic_exchange(&done, NULL));
    fvi_preparer_free_f32(preparer);
    fvi_convolver_free_f32(convolver);
    return facts.overruns != 0 || !(loudest > 0.0);
}
