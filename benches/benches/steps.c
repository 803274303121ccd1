/* The scheme of steps.rs for one system, as one would write it in C: plain updates, no checks, no rows. Compiled for SYSTEM and N by
 * the bench. It reads the memory's table from its input,
 *
 *     n0 J   W_0 … W_{n0-1}   mu_1 … mu_J   u_1 … u_J ,   J a multiple of 4,
 *
 * with W_n = sum u_j (1 - mu_j)^(n - n0) from n0 on, makes as many steps as its argument says, and prints the nanoseconds of a step in
 * the fastest fiftieth of them, then positions and momenta after the first thousand.
 */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { OSCILLATOR, PENDULUM, LINEAR_CHAIN, NONLINEAR_CHAIN };

#define STEP 0.01
#define DAMPING 0.1
#define GRAVITY 9.81
#define STIFFNESS 4.0
#define CUBIC 0.7
#define LANES 4
#define MOST 512

static int head, terms;
static double weights[MOST], decay[MOST], output[MOST];
static double running[MOST][N], recent[MOST][N];
static int newest; /* Place of the last increment in `recent`. */
static double q[N], p[N], e[N], pull[N], known[N], inverse[N][N];

static int number(double *to)
{
    return scanf("%lf", to) == 1;
}

static int read_table(void)
{
    int good = scanf("%d %d", &head, &terms) == 2 && head < MOST && terms < MOST;
    for (int n = 0; good && n < head; n++) good = number(&weights[n]);
    for (int j = 0; good && j < terms; j++) good = number(&decay[j]);
    for (int j = 0; good && j < terms; j++) good = number(&output[j]);
    return good;
}

/* sum over n >= 1 of W_n x_{k+1-n}: the terms of the sum that do not depend on the step's own increment. */
static void memory_term(void)
{
    for (int i = 0; i < N; i++) known[i] = 0.0;
#if N == 1
    double sums[LANES] = {0.0};
    for (int j = 0; j < terms; j += LANES)
        for (int lane = 0; lane < LANES; lane++) sums[lane] += output[j + lane] * running[j + lane][0];
    for (int lane = 0; lane < LANES; lane++) known[0] += sums[lane];
#else
    for (int j = 0; j < terms; j++)
        for (int i = 0; i < N; i++) known[i] += output[j] * running[j][i];
#endif
    for (int n = 1; n < head; n++) {
        int place = newest - n + 1;
        const double *x = recent[place < 0 ? place + head : place];
        for (int i = 0; i < N; i++) known[i] += weights[n] * x[i];
    }
}

static void memory_push(void)
{
    newest = newest + 1 == head ? 0 : newest + 1;
    memcpy(recent[newest], e, sizeof e);
    /* What leaves the head enters the sums: it is the oldest, which the next one replaces. */
    const double *oldest = recent[newest + 1 == head ? 0 : newest + 1];
    for (int j = 0; j < terms; j++)
        for (int i = 0; i < N; i++) running[j][i] += oldest[i] - decay[j] * running[j][i];
}

static void gradient(const double *at)
{
    for (int i = 0; i < N; i++) {
        double left = i > 0 ? at[i - 1] : 0.0, right = i + 1 < N ? at[i + 1] : 0.0;
        pull[i] = STIFFNESS * (2.0 * at[i] - left - right);
    }
}

/* (1 + h^2 K/4)^-1 by Gauss and Jordan. */
static void prepare(void)
{
    double matrix[N][N];
    for (int i = 0; i < N; i++)
        for (int j = 0; j < N; j++) {
            double entry = i == j ? 2.0 * STIFFNESS : abs(i - j) == 1 ? -STIFFNESS : 0.0;
            matrix[i][j] = (i == j) + 0.25 * STEP * STEP * entry;
            inverse[i][j] = i == j;
        }
    for (int k = 0; k < N; k++) {
        double pivot = matrix[k][k];
        for (int j = 0; j < N; j++) matrix[k][j] /= pivot, inverse[k][j] /= pivot;
        for (int i = 0; i < N; i++) {
            double factor = matrix[i][k];
            for (int j = 0; i != k && j < N; j++) matrix[i][j] -= factor * matrix[k][j], inverse[i][j] -= factor * inverse[k][j];
        }
    }
}

static int at_rest(const double *correction)
{
    double largest = 0.0, extent = 0.0, change = 0.0;
    for (int i = 0; i < N; i++) {
        largest = fabs(correction[i]) > largest ? fabs(correction[i]) : largest;
        extent = fabs(q[i]) > extent ? fabs(q[i]) : extent;
        change = fabs(e[i]) > change ? fabs(e[i]) : change;
    }
    return largest <= 2.0 * 0x1p-52 * (extent + change);
}

/* Increments e from the guess h p, and the gradient at the midpoint. */
static void solve(void)
{
#if SYSTEM == 1
    double correction;
    do {
        double angle = q[0] + 0.5 * e[0];
        double residual = p[0] - e[0] / STEP - 0.5 * STEP * GRAVITY * sin(angle);
        correction = residual / (-1.0 / STEP - 0.25 * STEP * GRAVITY * cos(angle));
        e[0] -= correction;
    } while (!at_rest(&correction));
    pull[0] = GRAVITY * sin(q[0] + 0.5 * e[0]);
#elif SYSTEM == 3
    double middle[N], diagonal[N], beside[N], rest[N];
    do {
        const double quarter = 0.25 * STEP * STEP;
        for (int i = 0; i < N; i++) middle[i] = q[i] + 0.5 * e[i], pull[i] = 0.0, diagonal[i] = 1.0;
        pull[0] = 4.0 * middle[0];
        diagonal[0] += quarter * 4.0;
        for (int i = 1; i < N; i++) {
            double stretch = middle[i] - middle[i - 1], square = stretch * stretch;
            double tension = stretch + CUBIC * stretch * square, stiffness = quarter * (1.0 + 3.0 * CUBIC * square);
            pull[i] += tension, pull[i - 1] -= tension;
            diagonal[i] += stiffness, diagonal[i - 1] += stiffness;
            beside[i] = -stiffness;
        }
        for (int i = 0; i < N; i++) rest[i] = e[i] - STEP * p[i] + 0.5 * STEP * STEP * pull[i];
        for (int i = 1; i < N; i++) {
            double factor = beside[i] / diagonal[i - 1];
            diagonal[i] -= factor * beside[i], rest[i] -= factor * rest[i - 1];
        }
        rest[N - 1] /= diagonal[N - 1];
        for (int i = N - 2; i >= 0; i--) rest[i] = (rest[i] - beside[i + 1] * rest[i + 1]) / diagonal[i];
        for (int i = 0; i < N; i++) e[i] -= rest[i];
    } while (!at_rest(rest));
    for (int i = 0; i < N; i++) middle[i] = q[i] + 0.5 * e[i], pull[i] = 0.0;
    pull[0] = 4.0 * middle[0];
    for (int i = 1; i < N; i++) {
        double stretch = middle[i] - middle[i - 1], tension = stretch + CUBIC * stretch * stretch * stretch;
        pull[i] += tension, pull[i - 1] -= tension;
    }
#else
    double right[N], middle[N];
    gradient(q);
    for (int i = 0; i < N; i++) right[i] = STEP * p[i] - 0.5 * STEP * STEP * pull[i], e[i] = 0.0;
    for (int j = 0; j < N; j++)
        for (int i = 0; i < N; i++) e[i] += inverse[j][i] * right[j];
    for (int i = 0; i < N; i++) middle[i] = q[i] + 0.5 * e[i];
    gradient(middle);
#endif
}

static void step(void)
{
    memory_term();
    for (int i = 0; i < N; i++) e[i] = STEP * p[i];
    solve();
    for (int i = 0; i < N; i++) {
        q[i] += e[i];
        p[i] -= STEP * (pull[i] + DAMPING * (known[i] + weights[0] * e[i]));
    }
    memory_push();
}

static double now(void)
{
    struct timespec time;
    clock_gettime(CLOCK_MONOTONIC, &time);
    return 1e9 * (double)time.tv_sec + (double)time.tv_nsec;
}

int main(int count, char **words)
{
    long steps = count > 1 ? atol(words[1]) : 0;
    if (steps < 50 || !read_table()) return 1;
    for (int i = 0; i < N; i++) q[i] = sin(0.7 * i) + 0.3;
    prepare();
    double early[2][N], fastest = INFINITY;
    long stretch = steps / 50;
    for (long made = 0; made + stretch <= steps; made += stretch) {
        double begin = now();
        for (long k = 0; k < stretch; k++) {
            step();
            if (made + k + 1 == 1000) memcpy(early[0], q, sizeof q), memcpy(early[1], p, sizeof p);
        }
        double took = (now() - begin) / (double)stretch;
        fastest = took < fastest ? took : fastest;
    }
    printf("%.17g\n", fastest);
    for (int i = 0; i < N; i++) printf("%.17g %.17g\n", early[0][i], early[1][i]);
    return 0;
}
