/* C interface of fvi: fractional operators on a stream, a fractional PID controller, and a stepper for fractionally damped systems.
 *
 * All state is the caller's, of a size known at compile time. Nothing is allocated. Every call that can be wrong returns a
 * status; any status but FVI_STATUS_OK means that the call has changed nothing. Numbers are single precision.
 *
 * Generated; do not edit. */

#ifndef FVI_H
#define FVI_H

#include <stddef.h>
#include <stdint.h>
/* Numbers in the buffer of an exponential sum with the given numbers of head weights, of exponential_count, of far blocks, and of
 * channels. */
#define FVI_EXPONENTIAL_NUMBERS(head, exponentials, far_blocks, channels) \
    (1 + ((head) + ((head) > 2 ? (head) - 2 : 0) + 1 + (exponentials) + 4 * (far_blocks)) * (channels))

/*
 Kind of memory: a ring that takes as many samples as it has room for and then refuses further ones.
 */
#define FVI_FULL_MEMORY 0

/*
 Kind of memory: a ring that drops the oldest sample. The sum is then truncated at the largest lags.
 */
#define FVI_SHORT_MEMORY 1

/*
 Kind of memory: a head of weights and a sum of decaying exponentials. No ring, the same cost at every
 step.
 */
#define FVI_EXPONENTIAL_SUM 2

/*
 Added to the kind of a memory: its weights are for increments, sums w_0 + … + w_n of those for values
 (fvi_increment_weights_bdf), and the rounding error is smaller. Steppers have the increments without a
 subtraction.
 */
#define FVI_ON_INCREMENTS 256

/*
 Added to FVI_EXPONENTIAL_SUM: past the horizon of its table the memory continues and drops older samples;
 without it, it refuses samples there.
 */
#define FVI_FORGET_PAST_HORIZON 512

/*
 Horizon of a table of exponentials without an end.
 */
#define FVI_ENDLESS UINT64_MAX

/*
 Start: nothing is subtracted; the operator of Riemann–Liouville type. Fractional integrals are of this
 type.
 */
#define FVI_RIEMANN_LIOUVILLE 0

/*
 Start: the first sample is subtracted; the Caputo derivative of an order up to 1.
 */
#define FVI_CAPUTO 1

/*
 Start: the first sample and `rise` per step are subtracted; the Caputo derivative of an order between 1
 and 2.
 */
#define FVI_CAPUTO_WITH_RISE 2

/*
 Number of 64-bit words of an operator.
 */
#define FVI_OPERATOR_WORDS 24

/*
 Number of 64-bit words of a stepper for one coordinate.
 */
#define FVI_STEPPER_WORDS_1 48

/*
 Number of 64-bit words of a stepper for two coordinates.
 */
#define FVI_STEPPER_WORDS_2 61

/*
 Number of 64-bit words of a stepper for three coordinates.
 */
#define FVI_STEPPER_WORDS_3 79

/*
 Number of 64-bit words of a stepper for four coordinates.
 */
#define FVI_STEPPER_WORDS_4 101

/*
 Number of 64-bit words of a stepper for five coordinates.
 */
#define FVI_STEPPER_WORDS_5 126

/*
 Number of 64-bit words of a stepper for six coordinates.
 */
#define FVI_STEPPER_WORDS_6 156

/*
 Form: u = kp (b r - y) + ki I^lambda (r - y) + kd D^mu (c r - y), filtered.
 */
#define FVI_PID_PARALLEL 0

/*
 Form: C(s) = kp (1 + ki/s^lambda) (1 + kd s^mu) / (1 + (kd/filter_ratio) s^mu) on r - y: ki is 1/T_i, kd
 is T_d.
 */
#define FVI_PID_SERIES 1

/*
 The derivative is that of c r - y minus its first value: a loop at rest starts without a kick.
 */
#define FVI_PID_FROM_REST 0

/*
 The derivative is that of c r - y, taken as zero before the first tick.
 */
#define FVI_PID_OF_VALUES 1

/*
 The derivative is D^(mu - 1) of a measured rate of y; c is 0.
 */
#define FVI_PID_OF_RATE 2

/*
 No anti-windup.
 */
#define FVI_PID_NO_ANTI_WINDUP 0

/*
 Back-calculation with a tracking time.
 */
#define FVI_PID_BACK_CALCULATION 1

/*
 Conditional integration.
 */
#define FVI_PID_CONDITIONAL 2

/*
 A change of gains does not change the output at its first tick.
 */
#define FVI_PID_BUMPLESS 0

/*
 A change of gains changes the output at its first tick by the proportional term only.
 */
#define FVI_PID_EXCEPT_PROPORTIONAL 1

/*
 A change of gains changes the output freely.
 */
#define FVI_PID_BUMPS 2

/*
 The actuator applied the last output.
 */
#define FVI_PID_FOLLOWED 0

/*
 The actuator applied the value `applied`.
 */
#define FVI_PID_APPLIED 1

/*
 The actuator is at a limit unknown to the controller: the integral can only decrease in magnitude.
 */
#define FVI_PID_LIMITED 2

/*
 Number of 64-bit words of a controller.
 */
#define FVI_PID_WORDS 96

/*
 Number of 64-bit words of a controller in whole numbers.
 */
#define FVI_FIXED_PID_WORDS 36

/*
 The status returned by a call. Any status but FVI_STATUS_OK means that the call has changed nothing, with
 two exceptions: a call that sets up an object with an exponential sum may have cleared its buffer, and one
 that sets up a controller may have cleared the buffers of its memories, since it tests their weights with
 samples.
 */
typedef enum FviStatus {
  /*
   Success.
   */
  FVI_STATUS_OK = 0,
  /*
   A pointer is NULL that must not be.
   */
  FVI_STATUS_NULL = 1,
  /*
   A pointer is not aligned as its type requires.
   */
  FVI_STATUS_MISALIGNED = 2,
  /*
   A number is infinite or NaN: a parameter, a sample, a value written by a callback, or the result.
   */
  FVI_STATUS_NOT_FINITE = 3,
  /*
   A parameter is outside its range.
   */
  FVI_STATUS_OUT_OF_RANGE = 4,
  /*
   A buffer does not have the size that the call needs.
   */
  FVI_STATUS_WRONG_SIZE = 5,
  /*
   A matrix is not symmetric.
   */
  FVI_STATUS_NOT_SYMMETRIC = 6,
  /*
   The mass is not positive definite, or the damping not positive semidefinite.
   */
  FVI_STATUS_NOT_POSITIVE = 7,
  /*
   The state was never set up, or belongs to another kind of object.
   */
  FVI_STATUS_NOT_INITIALISED = 8,
  /*
   The memory is full, or the horizon of its table is reached.
   */
  FVI_STATUS_MEMORY_FULL = 9,
  /*
   Newton's method did not converge.
   */
  FVI_STATUS_NOT_CONVERGED = 10,
  /*
   The Jacobian of the step is singular.
   */
  FVI_STATUS_SINGULAR = 11,
  /*
   Saved bytes are incomplete, damaged, or the state of another object.
   */
  FVI_STATUS_WRONG_STATE = 12,
} FviStatus;

/*
 A stepper of any number of coordinates, in storage of the caller.
 */
typedef struct FviStepper FviStepper;

/*
 A memory: its kind, its kernel, and its buffer.

 Tables and buffer stay in use until the last call on the object that was set up with them; the buffer must
 belong to that object alone. The kernel is `scale` times the table. A new object has an empty memory,
 whatever the content of the buffer.
 */
typedef struct FviMemory {
  /*
   FVI_FULL_MEMORY, FVI_SHORT_MEMORY or FVI_EXPONENTIAL_SUM; with FVI_ON_INCREMENTS for weights on
   increments, and for an exponential sum with FVI_FORGET_PAST_HORIZON.
   */
  uint32_t kind;
  /*
   Factor of all weights: 1 for weights that contain the step size, h^(-exponent) for a table made for h
   = 1. fvi_memory_scale_bdf computes it.
   */
  float scale;
  /*
   Weights w_0, w_1, … of a ring; the head of an exponential sum.
   */
  const float *weights;
  /*
   Number of weights, at least 1; at least 2 for an exponential sum. Lags beyond a ring's weights count
   as zero.
   */
  size_t weight_count;
  /*
   Exponential sum: the exponentials in blocks of four, four decays and four coefficients each. Rings
   ignore this and the next five.
   */
  const float *exponentials;
  /*
   Exponential sum: number of floats in `exponentials`.
   */
  size_t exponential_count;
  /*
   Exponential sum: number of blocks, from the first, with slow exponentials.
   */
  size_t slow_blocks;
  /*
   Exponential sum: number of these, from the first, whose sums are stored in three parts.
   */
  size_t far_blocks;
  /*
   Exponential sum: largest lag at which the table is accurate, and largest number of samples.
   FVI_ENDLESS for a table without an end.
   */
  uint64_t horizon;
  /*
   Exponential sum: the step size contained in the weights; the scale must then be 1. 1 for a table that
   may be scaled to any step size, 0 if it is not known.
   */
  double step_size;
  /*
   The buffer. Ring: one sample per step and channel. Exponential sum: FVI_EXPONENTIAL_NUMBERS.
   */
  float *buffer;
  /*
   Numbers in the buffer. A ring with c channels takes `buffer_count` / c samples.
   */
  size_t buffer_count;
} FviMemory;

/*
 A fractional operator on a stream: takes a sample x_k and returns Σ_{n=0}^{k} w_n x_{k−n}.

 Set all words to zero before the first call.
 */
typedef struct FviOperator {
  /*
   Internal state; not to be accessed by the caller.
   */
  uint64_t words[FVI_OPERATOR_WORDS];
} FviOperator;

/*
 Storage of a stepper for one coordinate.
 */
typedef struct FviStepper1 {
  /*
   Internal state; not to be accessed by the caller. Set all words to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_1];
} FviStepper1;

/*
 Writes ∇U(q), n numbers, to `gradient`.
 */
typedef void (*FviGradient)(void *context, const float *position, float *gradient);

/*
 Writes ∂²U/∂q², n² numbers row by row, to `hessian`. It must be the derivative of the gradient.
 */
typedef void (*FviHessian)(void *context, const float *position, float *hessian);

/*
 Writes the external force F(t, q), n numbers, to `force`. Its dependence on q must be weak.
 */
typedef void (*FviForce)(void *context, float time, const float *position, float *force);

/*
 A system M q̈ + ∇U(q) + ρ D^β q = F(t, q) + u and how it is integrated: the low-order fractional
 variational integrator.

 The number of coordinates n is that of the function that sets it up. Matrices are n×n numbers row by row.
 After the stepper is set up, only the tables and the buffer of the memory and the object behind `context`
 must remain valid.
 */
typedef struct FviSystem {
  /*
   Mass M, symmetric positive definite.
   */
  const float *mass;
  /*
   Coefficients ρ of the damping, symmetric positive semidefinite.
   */
  const float *damping;
  /*
   Damping order β, 0 ≤ β < 2.
   */
  float damping_order;
  /*
   FVI_RIEMANN_LIOUVILLE or FVI_CAPUTO.
   */
  uint32_t derivative;
  /*
   Memory with n channels whose kernel is that of D^β for the step size.
   */
  const struct FviMemory *memory;
  /*
   Step size h.
   */
  float step_size;
  /*
   κ in [0, 1]: the potential is taken at κ q_k + (1−κ) q_{k+1}; ½ is the midpoint rule.
   */
  float kappa;
  /*
   Initial position, n numbers.
   */
  const float *position;
  /*
   Initial momentum, n numbers.
   */
  const float *momentum;
  /*
   ∇U.
   */
  FviGradient gradient;
  /*
   ∂²U/∂q².
   */
  FviHessian hessian;
  /*
   External force, or NULL.
   */
  FviForce force;
  /*
   Passed to the callbacks unchanged.
   */
  void *context;
} FviSystem;

/*
 Storage of a stepper for two coordinates.
 */
typedef struct FviStepper2 {
  /*
   Internal state; not to be accessed by the caller. Set all words to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_2];
} FviStepper2;

/*
 Storage of a stepper for three coordinates.
 */
typedef struct FviStepper3 {
  /*
   Internal state; not to be accessed by the caller. Set all words to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_3];
} FviStepper3;

/*
 Storage of a stepper for four coordinates.
 */
typedef struct FviStepper4 {
  /*
   Internal state; not to be accessed by the caller. Set all words to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_4];
} FviStepper4;

/*
 Storage of a stepper for five coordinates.
 */
typedef struct FviStepper5 {
  /*
   Internal state; not to be accessed by the caller. Set all words to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_5];
} FviStepper5;

/*
 Storage of a stepper for six coordinates.
 */
typedef struct FviStepper6 {
  /*
   Internal state; not to be accessed by the caller. Set all words to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_6];
} FviStepper6;

/*
 A control law. Members that are zero mean: no limits, no filter, default orders; the setpoint weights are
 used as given.
 */
typedef struct FviPidSettings {
  /*
   Time between ticks.
   */
  double sample;
  /*
   Order of the integral, above 0 and below 2; 0 stands for 1.
   */
  double lambda;
  /*
   Order of the derivative, above 0 and below 2; 0 stands for 1.
   */
  double mu;
  /*
   Time of the derivative's filter in the parallel form; 0 for none.
   */
  double filter_time;
  /*
   Order of that filter; 0 stands for 1, other orders need a memory.
   */
  double filter_order;
  /*
   Back-calculation: the tracking time.
   */
  double tracking_time;
  /*
   Gains; in the series form kp, 1/T_i and T_d.
   */
  float kp;
  /*
   See kp.
   */
  float ki;
  /*
   See kp.
   */
  float kd;
  /*
   Series form: the filter ratio N.
   */
  float filter_ratio;
  /*
   b and c of the parallel form.
   */
  float setpoint_weights[2];
  /*
   The smallest and the largest output; two zeros for no limits. Infinities are allowed.
   */
  float limits[2];
  /*
   Largest rate of change of the output per unit of time; 0 for no limit.
   */
  float rate_limit;
  /*
   FVI_PID_PARALLEL or FVI_PID_SERIES.
   */
  uint32_t form;
  /*
   FVI_PID_FROM_REST, FVI_PID_OF_VALUES or FVI_PID_OF_RATE.
   */
  uint32_t derivative_of;
  /*
   FVI_PID_NO_ANTI_WINDUP, FVI_PID_BACK_CALCULATION or FVI_PID_CONDITIONAL.
   */
  uint32_t anti_windup;
  /*
   FVI_PID_BUMPLESS, FVI_PID_EXCEPT_PROPORTIONAL or FVI_PID_BUMPS.
   */
  uint32_t bumpless;
} FviPidSettings;

/*
 A fractional PID controller.

 Set all words to zero before the first call.
 */
typedef struct FviPid {
  /*
   Internal state; not to be accessed by the caller.
   */
  uint64_t words[FVI_PID_WORDS];
} FviPid;

/*
 Inputs of a tick.
 */
typedef struct FviPidInputs {
  /*
   r.
   */
  float setpoint;
  /*
   y.
   */
  float measured;
  /*
   The rate of y, for FVI_PID_OF_RATE.
   */
  float rate;
  /*
   Added to the output, inside its limits.
   */
  float feed_forward;
  /*
   FVI_PID_FOLLOWED, FVI_PID_APPLIED or FVI_PID_LIMITED.
   */
  uint32_t actuator;
  /*
   Output of the previous tick as the actuator applied it.
   */
  float applied;
} FviPidInputs;

/*
 A fractional PID controller in whole numbers.

 Set all words to zero before the first call.
 */
typedef struct FviFixedPid {
  /*
   Internal state; not to be accessed by the caller.
   */
  uint64_t words[FVI_FIXED_PID_WORDS];
} FviFixedPid;

/*
 A factor mantissa 2^-shift.
 */
typedef struct FviFixedGain {
  /*
   Mantissa.
   */
  int32_t mantissa;
  /*
   Shift.
   */
  int32_t shift;
} FviFixedGain;

/*
 A decaying exponential of an operator.
 */
typedef struct FviFixedTerm {
  /*
   What it loses in a tick; zero for a sum that stays.
   */
  struct FviFixedGain decay;
  /*
   From its value to the output.
   */
  struct FviFixedGain output;
  /*
   Binary digits of its value behind those of a sample.
   */
  int32_t lift;
} FviFixedTerm;

/*
 The law of a controller in whole numbers, with all factors between counts of the inputs and units of 2^-16
 counts of the output. `fvi controller --arithmetic fixed --format c` makes it.
 */
typedef struct FviFixedLaw {
  /*
   First weights of the integral; NULL with a count of 0 for none.
   */
  const struct FviFixedGain *integral_head;
  /*
   Its exponentials.
   */
  const struct FviFixedTerm *integral_terms;
  /*
   First weights of the derivative.
   */
  const struct FviFixedGain *derivative_head;
  /*
   Its exponentials.
   */
  const struct FviFixedTerm *derivative_terms;
  /*
   Smallest and largest output, in units of 2^-16 counts.
   */
  int64_t limits[2];
  /*
   Largest change of the output in a tick, in units of 2^-16 counts.
   */
  int64_t stride;
  /*
   Number of weights.
   */
  uint32_t integral_head_count;
  /*
   Number of exponentials.
   */
  uint32_t integral_terms_count;
  /*
   Number of weights.
   */
  uint32_t derivative_head_count;
  /*
   Number of exponentials.
   */
  uint32_t derivative_terms_count;
  /*
   Gain of the setpoint.
   */
  struct FviFixedGain setpoint;
  /*
   Gain of the measured value.
   */
  struct FviFixedGain measured;
  /*
   Weight of the setpoint in the derivative, 2^5 times.
   */
  struct FviFixedGain derivative_weight;
  /*
   Share of a new sample in the derivative's filter; 1 for no filter.
   */
  struct FviFixedGain filter_share;
  /*
   Factor of the anti-windup, from the output to a sample of the integral.
   */
  struct FviFixedGain windup;
  /*
   FVI_PID_FROM_REST or FVI_PID_OF_VALUES.
   */
  uint32_t derivative_of;
  /*
   FVI_PID_NO_ANTI_WINDUP, FVI_PID_BACK_CALCULATION or FVI_PID_CONDITIONAL.
   */
  uint32_t anti_windup;
} FviFixedLaw;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 A short English text for a status; an unknown one has a text as well. Never NULL.
 */
const char *fvi_status_text(int32_t status);

/*
 Compares the weights of a memory with those of D^exponent by a backward differentiation formula at a step
 size, sets the scale for which they agree, and sets FVI_ON_INCREMENTS if they are weights for increments.

 A table that contains its step size is not scaled a second time; one made for h = 1 gets the right scale.
 `order` is 1…6; −1 < exponent < 2. The first eight weights are compared. Returns FVI_STATUS_NULL,
 FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE, or FVI_STATUS_OUT_OF_RANGE if a parameter is out of range,
 the weights are those of another operator, or the table contains another step size; the memory is then
 unchanged.

 # Safety
 `memory` must be as its type describes, and writable.
 */
enum FviStatus fvi_memory_scale_bdf(struct FviMemory *memory, uint32_t order, double exponent, double step_size);

/*
 Sets up an operator on an empty memory.

 `start` is FVI_RIEMANN_LIOUVILLE, FVI_CAPUTO or FVI_CAPUTO_WITH_RISE; `rise` is the initial slope times
 the step size, for the last only. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE,
 FVI_STATUS_OUT_OF_RANGE or FVI_STATUS_WRONG_SIZE if something is wrong with a pointer, a number or a size.

 # Safety
 `operation` must be writable, `memory` as its type describes.
 */
enum FviStatus fvi_operator_init(struct FviOperator *operation,
                                 const struct FviMemory *memory,
                                 uint32_t start,
                                 float rise);

/*
 Takes a sample and writes the value of the operator to `result`.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE or
 FVI_STATUS_MEMORY_FULL; then neither operator nor `result` has changed.

 # Safety
 `operation` must be zeroed or set up, `result` writable.
 */
enum FviStatus fvi_operator_push(struct FviOperator *operation, float sample, float *result);

/*
 Writes what fvi_operator_push would write, without changing the operator.

 Returns what fvi_operator_push returns.

 # Safety
 As for fvi_operator_push.
 */
enum FviStatus fvi_operator_peek(struct FviOperator *operation, float sample, float *result);

/*
 Takes a sample for each of two operators; on an error neither takes its sample.

 Writes the two values to `results`. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED,
 FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE, FVI_STATUS_MEMORY_FULL, or FVI_STATUS_OUT_OF_RANGE if
 both are the same operator; then neither operator nor `results` has changed.

 # Safety
 `first` and `second` must be zeroed or set up, `samples` readable and `results` writable for two numbers.
 */
enum FviStatus fvi_operator_push_two(struct FviOperator *first,
                                     struct FviOperator *second,
                                     const float *samples,
                                     float *results);

/*
 Removes all samples.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `operation` must be zeroed or set up.
 */
enum FviStatus fvi_operator_clear(struct FviOperator *operation);

/*
 Writes the convolution-quadrature weights w_0 … w_{count−1} of D^exponent for a step size.

 `order` is that of the backward differentiation formula, 1…6; −1 < exponent < 2; negative for fractional
 integrals. The weights contain the step size, so that the scale of the memory is 1. They are computed in
 double precision, which is emulated in software on processors without it. Returns FVI_STATUS_NULL,
 FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE or FVI_STATUS_OUT_OF_RANGE.

 # Safety
 `weights` must be writable for `count` numbers.
 */
enum FviStatus fvi_weights_bdf(uint32_t order, double exponent, double step_size, float *weights, size_t count);

/*
 Writes the weights of the same operator for memories on increments (FVI_ON_INCREMENTS): w_0, w_0 + w_1, …

 Otherwise as fvi_weights_bdf.

 # Safety
 `weights` must be writable for `count` numbers.
 */
enum FviStatus fvi_increment_weights_bdf(uint32_t order,
                                         double exponent,
                                         double step_size,
                                         float *weights,
                                         size_t count);

/*
 Sets up a stepper for one coordinate at t = 0 in `storage` and writes its address to `stepper`.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE, FVI_STATUS_OUT_OF_RANGE,
 FVI_STATUS_WRONG_SIZE, FVI_STATUS_NOT_SYMMETRIC or FVI_STATUS_NOT_POSITIVE; then neither `storage` nor
 `stepper` has changed.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_1(struct FviStepper1 *storage,
                                  const struct FviSystem *system,
                                  struct FviStepper **stepper);

/*
 Sets up a stepper for two coordinates at t = 0 in `storage` and writes its address to `stepper`.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_2(struct FviStepper2 *storage,
                                  const struct FviSystem *system,
                                  struct FviStepper **stepper);

/*
 Sets up a stepper for three coordinates at t = 0 in `storage` and writes its address to `stepper`.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_3(struct FviStepper3 *storage,
                                  const struct FviSystem *system,
                                  struct FviStepper **stepper);

/*
 Sets up a stepper for four coordinates at t = 0 in `storage` and writes its address to `stepper`.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_4(struct FviStepper4 *storage,
                                  const struct FviSystem *system,
                                  struct FviStepper **stepper);

/*
 Sets up a stepper for five coordinates at t = 0 in `storage` and writes its address to `stepper`.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_5(struct FviStepper5 *storage,
                                  const struct FviSystem *system,
                                  struct FviStepper **stepper);

/*
 Sets up a stepper for six coordinates at t = 0 in `storage` and writes its address to `stepper`.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_6(struct FviStepper6 *storage,
                                  const struct FviSystem *system,
                                  struct FviStepper **stepper);

/*
 Sets up a stepper for one coordinate at t = 0 in `storage` and writes its address to `stepper`; the
 fractional force acts at κ q_k + (1−κ) q_{k+1}, like the potential, instead of at the end of the step.

 With κ = ½ the momentum is of order 2 too, and with weights of order 1 or 2 every step size is stable. The
 memory takes one sample in each step and none at t = 0. Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_at_node_1(struct FviStepper1 *storage,
                                          const struct FviSystem *system,
                                          struct FviStepper **stepper);

/*
 Sets up a stepper for two coordinates at t = 0 in `storage` and writes its address to `stepper`, damped as
 with fvi_stepper_init_at_node_1.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_at_node_2(struct FviStepper2 *storage,
                                          const struct FviSystem *system,
                                          struct FviStepper **stepper);

/*
 Sets up a stepper for three coordinates at t = 0 in `storage` and writes its address to `stepper`, damped
 as with fvi_stepper_init_at_node_1.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_at_node_3(struct FviStepper3 *storage,
                                          const struct FviSystem *system,
                                          struct FviStepper **stepper);

/*
 Sets up a stepper for four coordinates at t = 0 in `storage` and writes its address to `stepper`, damped
 as with fvi_stepper_init_at_node_1.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_at_node_4(struct FviStepper4 *storage,
                                          const struct FviSystem *system,
                                          struct FviStepper **stepper);

/*
 Sets up a stepper for five coordinates at t = 0 in `storage` and writes its address to `stepper`, damped
 as with fvi_stepper_init_at_node_1.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_at_node_5(struct FviStepper5 *storage,
                                          const struct FviSystem *system,
                                          struct FviStepper **stepper);

/*
 Sets up a stepper for six coordinates at t = 0 in `storage` and writes its address to `stepper`, damped as
 with fvi_stepper_init_at_node_1.

 Returns what fvi_stepper_init_1 returns.

 # Safety
 `storage` and `stepper` must be writable, `system` as its type describes.
 */
enum FviStatus fvi_stepper_init_at_node_6(struct FviStepper6 *storage,
                                          const struct FviSystem *system,
                                          struct FviStepper **stepper);

/*
 Makes one step with the input u, n numbers held over the step, or NULL for none.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE,
 FVI_STATUS_MEMORY_FULL, FVI_STATUS_NOT_CONVERGED or FVI_STATUS_SINGULAR; then the stepper is unchanged,
 and the step may be tried again.

 # Safety
 `stepper` must come from fvi_stepper_init_n or point to zeroed storage, `input` be NULL or hold n numbers.
 The callbacks must not call this function on the same stepper.
 */
enum FviStatus fvi_stepper_step(struct FviStepper *stepper, const float *input);

/*
 Writes position and momentum, n numbers each, and the number of steps made; each pointer may be NULL.

 Where damping acts at the main nodes, the momentum is the one after the kick at the end of the step, of
 order 1; at the node there is one momentum only.

 Returns FVI_STATUS_NULL if `stepper` is NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `stepper` must come from fvi_stepper_init_n or point to zeroed storage, the others be NULL or writable.
 */
enum FviStatus fvi_stepper_state(const struct FviStepper *stepper, float *position, float *momentum, uint64_t *steps);

/*
 Saves an operator: writes its state to `bytes` and the number of bytes to `written`. With a capacity of 0
 only the number of bytes that are needed at present is written; for rings it grows as they fill.

 The bytes are the same on every machine. They contain no checksum; where stored bits can change, add one.
 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or
 FVI_STATUS_WRONG_SIZE if the capacity is too small; then nothing is written.

 # Safety
 `operation` must be zeroed or set up, `capacity` bytes and `written` writable.
 */
enum FviStatus fvi_operator_save(const struct FviOperator *operation, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_operator_save wrote, into an operator that was set up with the same memory and start: it
 then continues bit-identically. Bytes after the state, up to `count`, are ignored.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or
 FVI_STATUS_WRONG_STATE if the bytes are not the state of such an operator, which is then unchanged.

 # Safety
 `operation` must be zeroed or set up, `count` bytes readable.
 */
enum FviStatus fvi_operator_restore(struct FviOperator *operation, const uint8_t *bytes, size_t count);

/*
 Saves a stepper for one coordinate: writes step, position, momentum and the state of its memory to
 `bytes`, and the number of bytes to `written`. With a capacity of 0 only the number of bytes that are
 needed at present is written; for rings it grows as they fill.

 The bytes are the same on every machine. They contain no checksum; where stored bits can change, add one.
 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or
 FVI_STATUS_WRONG_SIZE if the capacity is too small or the stepper has another number of coordinates; then
 nothing is written.

 # Safety
 `stepper` must come from fvi_stepper_init_n or fvi_stepper_init_at_node_n or point to zeroed storage,
 `capacity` bytes and `written` be writable.
 */
enum FviStatus fvi_stepper_save_1(const struct FviStepper *stepper, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_stepper_save_1 wrote, into a stepper set up in the same way, which then continues
 bit-identically. System, scheme and damping order are not compared. Bytes after the state, up to `count`,
 are ignored.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE,
 FVI_STATUS_WRONG_SIZE if the stepper has another number of coordinates, or FVI_STATUS_WRONG_STATE if the
 bytes are not the state of such a stepper, which is then unchanged.

 # Safety
 `stepper` must come from fvi_stepper_init_n or fvi_stepper_init_at_node_n or point to zeroed storage,
 `count` bytes be readable.
 */
enum FviStatus fvi_stepper_restore_1(struct FviStepper *stepper, const uint8_t *bytes, size_t count);

/*
 Saves a stepper for two coordinates, as fvi_stepper_save_1 does for one.

 # Safety
 As fvi_stepper_save_1.
 */
enum FviStatus fvi_stepper_save_2(const struct FviStepper *stepper, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_stepper_save_2 wrote, as fvi_stepper_restore_1 does for one coordinate.

 # Safety
 As fvi_stepper_restore_1.
 */
enum FviStatus fvi_stepper_restore_2(struct FviStepper *stepper, const uint8_t *bytes, size_t count);

/*
 Saves a stepper for three coordinates, as fvi_stepper_save_1 does for one.

 # Safety
 As fvi_stepper_save_1.
 */
enum FviStatus fvi_stepper_save_3(const struct FviStepper *stepper, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_stepper_save_3 wrote, as fvi_stepper_restore_1 does for one coordinate.

 # Safety
 As fvi_stepper_restore_1.
 */
enum FviStatus fvi_stepper_restore_3(struct FviStepper *stepper, const uint8_t *bytes, size_t count);

/*
 Saves a stepper for four coordinates, as fvi_stepper_save_1 does for one.

 # Safety
 As fvi_stepper_save_1.
 */
enum FviStatus fvi_stepper_save_4(const struct FviStepper *stepper, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_stepper_save_4 wrote, as fvi_stepper_restore_1 does for one coordinate.

 # Safety
 As fvi_stepper_restore_1.
 */
enum FviStatus fvi_stepper_restore_4(struct FviStepper *stepper, const uint8_t *bytes, size_t count);

/*
 Saves a stepper for five coordinates, as fvi_stepper_save_1 does for one.

 # Safety
 As fvi_stepper_save_1.
 */
enum FviStatus fvi_stepper_save_5(const struct FviStepper *stepper, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_stepper_save_5 wrote, as fvi_stepper_restore_1 does for one coordinate.

 # Safety
 As fvi_stepper_restore_1.
 */
enum FviStatus fvi_stepper_restore_5(struct FviStepper *stepper, const uint8_t *bytes, size_t count);

/*
 Saves a stepper for six coordinates, as fvi_stepper_save_1 does for one.

 # Safety
 As fvi_stepper_save_1.
 */
enum FviStatus fvi_stepper_save_6(const struct FviStepper *stepper, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_stepper_save_6 wrote, as fvi_stepper_restore_1 does for one coordinate.

 # Safety
 As fvi_stepper_restore_1.
 */
enum FviStatus fvi_stepper_restore_6(struct FviStepper *stepper, const uint8_t *bytes, size_t count);

/*
 The name of the first member of the settings that fvi_pid_init and fvi_pid_set would refuse, such as
 "lambda"; NULL if they are all right, and "settings" if the pointer is NULL or misaligned. Memories are
 not looked at.

 # Safety
 `settings` must be readable, or NULL.
 */
const char *fvi_pid_refused(const struct FviPidSettings *settings);

/*
 Sets up a controller on empty memories.

 The kernel of the integral's memory is D^-lambda for lambda < 1, else D^(1 - lambda). For lambda = 1 that
 is the identity, a ring with the single weight 1, or NULL: a P or PD controller is one with lambda = 1, ki
 = 0 and no memory of an integral. That of the derivative's memory is D^mu, or D^(mu - 1) for a rate; NULL
 without a derivative. That of the filter's memory is D^filter_order; NULL where the order is 1 or there is
 no filter. The memories are compared with these kernels. fvi_pid_refused names the member of the settings
 that is wrong. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE,
 FVI_STATUS_OUT_OF_RANGE or FVI_STATUS_WRONG_SIZE if something is wrong with a pointer, a number or a size.

 # Safety
 `controller` must be writable, `settings` readable, the memories as their type describes or NULL.
 */
enum FviStatus fvi_pid_init(struct FviPid *controller,
                            const struct FviPidSettings *settings,
                            const struct FviMemory *integral,
                            const struct FviMemory *derivative,
                            const struct FviMemory *filter);

/*
 Makes a tick with setpoint r and measured value y, and writes the output.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE or
 FVI_STATUS_MEMORY_FULL; then neither controller nor `output` has changed.

 # Safety
 `controller` must be zeroed or set up, `output` writable.
 */
enum FviStatus fvi_pid_tick(struct FviPid *controller, float setpoint, float measured, float *output);

/*
 Makes a tick with all inputs, and writes the output.

 Returns what fvi_pid_tick does, and FVI_STATUS_OUT_OF_RANGE for an unknown value of `actuator`.

 # Safety
 As for fvi_pid_tick; `inputs` must be readable.
 */
enum FviStatus fvi_pid_tick_with(struct FviPid *controller, const struct FviPidInputs *inputs, float *output);

/*
 Sets the output by hand, from the next tick on, within limits and rate limit; the memory of the integral
 is cleared. Before the first tick no rate holds it up: for a bumpless start, from where the actuator
 stands, fvi_pid_automatic may follow at once.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED or FVI_STATUS_NOT_FINITE.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_pid_manual(struct FviPid *controller, float output);

/*
 Returns the output to automatic control, without a jump: the output of the next tick equals that of the
 previous one.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_pid_automatic(struct FviPid *controller);

/*
 Changes the gains, from the next tick on; `bumpless` of the settings selects how the output may change.
 They are those of FviPidSettings: in the series form kp, 1/T_i and T_d.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE, or
 FVI_STATUS_OUT_OF_RANGE if a gain is not allowed, or a derivative lacks its memory.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_pid_set_gains(struct FviPid *controller, float kp, float ki, float kd);

/*
 Changes the settings, from the next tick on: gains, setpoint weights, limits, rate limit, anti-windup with
 its tracking time, filter time, and `bumpless`, which selects how the output may change where gains do.
 Form, orders, sample time and kind of derivative are those of the set-up.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE, or
 FVI_STATUS_OUT_OF_RANGE if a member is not allowed (fvi_pid_refused names it), needs other memories, or
 differs that may not.

 # Safety
 `controller` must be zeroed or set up, `settings` readable.
 */
enum FviStatus fvi_pid_set(struct FviPid *controller, const struct FviPidSettings *settings);

/*
 Writes the output of the last tick, 0 before the first, and the integral term in it, ki I^lambda of the
 samples as limits and transfers have changed them. A pointer that is NULL receives nothing.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `controller` must be zeroed or set up, `output` and `integral` writable or NULL.
 */
enum FviStatus fvi_pid_state(const struct FviPid *controller, float *output, float *integral);

/*
 Restores the state after set-up, with empty memories and in automatic mode; the gains are kept.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_pid_reset(struct FviPid *controller);

/*
 Saves the state of a controller with its memories, as fvi_operator_save does for an operator. The law is
 not part of it.

 # Safety
 `controller` must be zeroed or set up, `capacity` bytes and `written` writable.
 */
enum FviStatus fvi_pid_save(const struct FviPid *controller, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_pid_save wrote, into a controller set up in the same way, as fvi_operator_restore does
 for an operator.

 # Safety
 `controller` must be zeroed or set up, `count` bytes readable.
 */
enum FviStatus fvi_pid_restore(struct FviPid *controller, const uint8_t *bytes, size_t count);

/*
 Sets up a controller in whole numbers, with `state_count` numbers of state, which it clears. The law is
 copied; its arrays and the state are used as long as the controller is.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_OUT_OF_RANGE or FVI_STATUS_WRONG_SIZE if
 something is wrong with a pointer, a constant or the size.

 # Safety
 `controller` must be writable, `law` and the arrays that it names readable, `state_count` initialised
 numbers must lie at `state` that nobody else uses.
 */
enum FviStatus fvi_fixed_pid_init(struct FviFixedPid *controller,
                                  const struct FviFixedLaw *law,
                                  int64_t *state,
                                  size_t state_count);

/*
 Makes a tick with setpoint r and measured value y, in counts, and writes the output, in counts of its own.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `controller` must be zeroed or set up, `output` writable.
 */
enum FviStatus fvi_fixed_pid_tick(struct FviFixedPid *controller, int32_t setpoint, int32_t measured, int32_t *output);

/*
 Returns to the state before the first tick. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or
 FVI_STATUS_NOT_INITIALISED.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_fixed_pid_reset(struct FviFixedPid *controller);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* FVI_H */
