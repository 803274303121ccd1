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
 Kind of memory: a ring that takes as many samples as it holds and then refuses.
 */
#define FVI_FULL_MEMORY 0

/*
 Kind of memory: a ring that drops the oldest sample. The sum then lacks its far end.
 */
#define FVI_SHORT_MEMORY 1

/*
 Kind of memory: a head of weights and a sum of decaying exponentials. No ring, the same cost at every
 step.
 */
#define FVI_EXPONENTIAL_SUM 2

/*
 Added to the kind of a memory: its weights are for increments, sums w_0 + … + w_n of those for values
 (fvi_increment_weights_bdf), and lose less to rounding. Steppers know the increments without subtraction.
 */
#define FVI_ON_INCREMENTS 256

/*
 Added to FVI_EXPONENTIAL_SUM: past the horizon of its table the memory goes on and forgets, where it
 otherwise refuses samples.
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
 Words of an operator.
 */
#define FVI_OPERATOR_WORDS 24

/*
 Words of a stepper for one coordinate.
 */
#define FVI_STEPPER_WORDS_1 48

/*
 Words of a stepper for two coordinates.
 */
#define FVI_STEPPER_WORDS_2 61

/*
 Words of a stepper for three coordinates.
 */
#define FVI_STEPPER_WORDS_3 79

/*
 Words of a stepper for four coordinates.
 */
#define FVI_STEPPER_WORDS_4 101

/*
 Words of a stepper for five coordinates.
 */
#define FVI_STEPPER_WORDS_5 126

/*
 Words of a stepper for six coordinates.
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
 The derivative is of c r - y, zero before the first tick.
 */
#define FVI_PID_OF_VALUES 0

/*
 The derivative is of c r - y less its first value.
 */
#define FVI_PID_FROM_REST 1

/*
 The derivative is D^(mu - 1) of a measured rate of y; c is 0.
 */
#define FVI_PID_OF_RATE 2

/*
 Nothing against windup.
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
 A change of gains moves the output not at all on its first tick.
 */
#define FVI_PID_BUMPLESS 0

/*
 A change of gains moves the output by the proportional term.
 */
#define FVI_PID_EXCEPT_PROPORTIONAL 1

/*
 A change of gains moves the output.
 */
#define FVI_PID_BUMPS 2

/*
 The actuator did as it was told.
 */
#define FVI_PID_FOLLOWED 0

/*
 The actuator did what `applied` says.
 */
#define FVI_PID_APPLIED 1

/*
 The actuator is at a limit that the controller does not know: the integral only shrinks.
 */
#define FVI_PID_LIMITED 2

/*
 Words of a controller.
 */
#define FVI_PID_WORDS 96

/*
 What a call returns. Anything but FVI_STATUS_OK means that the call has changed nothing; only a call that
 sets up an object with an exponential sum may have emptied its buffer, and one that sets up a controller
 those of its memories, whose weights it looks at by samples.
 */
typedef enum FviStatus {
  /*
   Done.
   */
  FVI_STATUS_OK = 0,
  /*
   A pointer that must not be NULL is.
   */
  FVI_STATUS_NULL = 1,
  /*
   A pointer is not aligned as its type requires.
   */
  FVI_STATUS_MISALIGNED = 2,
  /*
   A number is infinite or not a number: a parameter, a sample, what a callback wrote, or the result.
   */
  FVI_STATUS_NOT_FINITE = 3,
  /*
   A parameter is outside what is allowed.
   */
  FVI_STATUS_OUT_OF_RANGE = 4,
  /*
   A buffer has another size than the call needs.
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
   The state was never set up, or belongs to something else.
   */
  FVI_STATUS_NOT_INITIALISED = 8,
  /*
   The memory holds as many samples as it can, or its table reaches no further.
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
   Saved bytes are cut off, damaged, or the state of another object.
   */
  FVI_STATUS_WRONG_STATE = 12,
} FviStatus;

/*
 A stepper of any number of coordinates, in storage of the caller.
 */
typedef struct FviStepper FviStepper;

/*
 A memory: which, for which kernel, and on which buffer.

 Tables and buffer stay in use until the last call on the object that was set up with them; the buffer must
 belong to that object alone. The kernel is `scale` times the table. A new object has an empty memory,
 whatever the buffer held.
 */
typedef struct FviMemory {
  /*
   FVI_FULL_MEMORY, FVI_SHORT_MEMORY or FVI_EXPONENTIAL_SUM; with FVI_ON_INCREMENTS for weights on
   increments, and for an exponential sum with FVI_FORGET_PAST_HORIZON.
   */
  uint32_t kind;
  /*
   Factor of all weights: 1 for weights that hold the step size, h^(-exponent) for a table made for
   h = 1. fvi_memory_scale_bdf finds it.
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
   Exponential sum: how many numbers those are.
   */
  size_t exponential_count;
  /*
   Exponential sum: how many blocks, from the first, hold slow exponentials.
   */
  size_t slow_blocks;
  /*
   Exponential sum: how many of these, from the first, have sums of three parts.
   */
  size_t far_blocks;
  /*
   Exponential sum: largest lag at which the table holds; so many samples are taken. FVI_ENDLESS for a
   table without an end.
   */
  uint64_t horizon;
  /*
   Exponential sum: the step size that the weights hold, with which the scale must be 1; 1 for a table
   that any step size may scale. 0 if that is not known.
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
 A fractional operator on a stream: takes a sample x_k, gives back Σ_{n=0}^{k} w_n x_{k−n}.

 Set all words to zero before the first call.
 */
typedef struct FviOperator {
  /*
   The state; not for the caller.
   */
  uint64_t words[FVI_OPERATOR_WORDS];
} FviOperator;

/*
 Storage of a stepper for one coordinate.
 */
typedef struct FviStepper1 {
  /*
   The state; not for the caller. Set all to zero before the first call.
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
 Everything but the tables and buffer of the memory and what `context` points to may go once the stepper is
 set up.
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
   Handed to the callbacks as it is.
   */
  void *context;
} FviSystem;

/*
 Storage of a stepper for two coordinates.
 */
typedef struct FviStepper2 {
  /*
   The state; not for the caller. Set all to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_2];
} FviStepper2;

/*
 Storage of a stepper for three coordinates.
 */
typedef struct FviStepper3 {
  /*
   The state; not for the caller. Set all to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_3];
} FviStepper3;

/*
 Storage of a stepper for four coordinates.
 */
typedef struct FviStepper4 {
  /*
   The state; not for the caller. Set all to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_4];
} FviStepper4;

/*
 Storage of a stepper for five coordinates.
 */
typedef struct FviStepper5 {
  /*
   The state; not for the caller. Set all to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_5];
} FviStepper5;

/*
 Storage of a stepper for six coordinates.
 */
typedef struct FviStepper6 {
  /*
   The state; not for the caller. Set all to zero before the first call.
   */
  uint64_t words[FVI_STEPPER_WORDS_6];
} FviStepper6;

/*
 A fractional PID controller.

 Set all words to zero before the first call.
 */
typedef struct FviPid {
  /*
   The state; not for the caller.
   */
  uint64_t words[FVI_PID_WORDS];
} FviPid;

/*
 A law. Zero members are those of a plain loop: no limits, no filter, setpoint weights as they are.
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
   Order of that filter; 0 stands for 1, other orders want a memory.
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
   Series form: N.
   */
  float filter_ratio;
  /*
   b and c of the parallel form.
   */
  float setpoint_weights[2];
  /*
   The least output and the largest; two zeros for none. Infinities are allowed.
   */
  float limits[2];
  /*
   How far the output moves in a unit of time; 0 for any.
   */
  float rate_limit;
  /*
   FVI_PID_PARALLEL or FVI_PID_SERIES.
   */
  uint32_t form;
  /*
   FVI_PID_OF_VALUES, FVI_PID_FROM_REST or FVI_PID_OF_RATE.
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
   Output of the tick before as the actuator applied it.
   */
  float applied;
} FviPidInputs;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 A short English text for a status; an unknown one has a text as well. Never NULL.
 */
const char *fvi_status_text(int32_t status);

/*
 Compares the weights of a memory with those of D^exponent by a backward differentiation formula at a step
 size, and sets the scale that makes them the same, and FVI_ON_INCREMENTS where they are sums.

 So a table that holds its step size is never scaled a second time, and one made for h = 1 is scaled as it
 must be. `order` is 1…6; −1 < exponent < 2. The first eight weights are compared. Returns FVI_STATUS_NULL,
 FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE, or FVI_STATUS_OUT_OF_RANGE if a parameter is out of range,
 the weights are those of another operator, or the table says that it holds another step size; the memory
 then is as before.

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
 Writes what fvi_operator_push would write; the operator stays as it is.

 Returns the same.

 # Safety
 As there.
 */
enum FviStatus fvi_operator_peek(struct FviOperator *operation, float sample, float *result);

/*
 Takes a sample for each of two operators, or none: a tick of both.

 Writes the two values to `results`. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED,
 FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE, FVI_STATUS_MEMORY_FULL, or FVI_STATUS_OUT_OF_RANGE if
 the two are one; then neither operator nor `results` has changed.

 # Safety
 `first` and `second` must be zeroed or set up, `samples` readable and `results` writable for two numbers.
 */
enum FviStatus fvi_operator_push_two(struct FviOperator *first,
                                     struct FviOperator *second,
                                     const float *samples,
                                     float *results);

/*
 Forgets all samples.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `operation` must be zeroed or set up.
 */
enum FviStatus fvi_operator_clear(struct FviOperator *operation);

/*
 Writes the convolution-quadrature weights w_0 … w_{count−1} of D^exponent for a step size.

 `order` is that of the backward differentiation formula, 1…6; −1 < exponent < 2; negative for fractional
 integrals. The weights hold the step size: the scale of the memory is 1. Computed in double precision, in
 software on parts that have none. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE or
 FVI_STATUS_OUT_OF_RANGE.

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
 fractional force acts at κ q_k + (1−κ) q_{k+1}, where the potential does, instead of the end of the step.

 With κ = ½ the momentum is of order 2 too, and with weights of order 1 or 2 every step size is stable. The
 memory takes a sample a step and none at t = 0. Returns what fvi_stepper_init_1 returns.

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
 FVI_STATUS_MEMORY_FULL, FVI_STATUS_NOT_CONVERGED or FVI_STATUS_SINGULAR; then the stepper is as it was,
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
 Saves an operator: writes what it remembers to `bytes` and the number of bytes to `written`. With a
 capacity of 0 it only says how many it would take at present; rings take more as they fill.

 The bytes are the same on every machine. Nothing guards against bits that change while they are stored;
 where that can happen, keep a checksum beside them. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED,
 FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or FVI_STATUS_WRONG_SIZE if the capacity is too
 small; then nothing is written.

 # Safety
 `operation` must be zeroed or set up, `capacity` bytes and `written` writable.
 */
enum FviStatus fvi_operator_save(const struct FviOperator *operation, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_operator_save wrote, into an operator that was set up with the same memory and start: it
 goes on with the same bits. Of the `count` bytes those behind the state are ignored.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or
 FVI_STATUS_WRONG_STATE if the bytes are not the state of such an operator; then it is as it was.

 # Safety
 `operation` must be zeroed or set up, `count` bytes readable.
 */
enum FviStatus fvi_operator_restore(struct FviOperator *operation, const uint8_t *bytes, size_t count);

/*
 Saves a stepper for one coordinate: writes step, position, momentum and what its memory holds to `bytes`,
 and the number of bytes to `written`. With a capacity of 0 it only says how many it would take at present;
 rings take more as they fill.

 The bytes are the same on every machine. Nothing guards against bits that change while they are stored;
 where that can happen, keep a checksum beside them. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED,
 FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE, or FVI_STATUS_WRONG_SIZE if the capacity is too small
 or the stepper has another number of coordinates; then nothing is written.

 # Safety
 `stepper` must come from fvi_stepper_init_n or fvi_stepper_init_at_node_n or point to zeroed storage,
 `capacity` bytes and `written` be writable.
 */
enum FviStatus fvi_stepper_save_1(const struct FviStepper *stepper, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_stepper_save_1 wrote, into a stepper that was set up alike: it goes on with the same
 bits. System, scheme and damping order are not compared. Of the `count` bytes those behind the state are
 ignored.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_OUT_OF_RANGE,
 FVI_STATUS_WRONG_SIZE if the stepper has another number of coordinates, or FVI_STATUS_WRONG_STATE if the
 bytes are not the state of such a stepper; then it is as it was.

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
 Sets up a controller on empty memories.

 The memory of the integral is of D^-lambda for lambda < 1, else of D^(1 - lambda): of lambda = 1 a ring of
 the one weight 1. That of the derivative is of D^mu, or D^(mu - 1) of a rate; NULL without a derivative.
 That of the filter is of D^filter_order; NULL where the order is 1 or there is none. They are compared
 with these kernels. Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_FINITE,
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
 Makes a tick with all that it may be told, and writes the output.

 Returns what fvi_pid_tick does, and FVI_STATUS_OUT_OF_RANGE for another actuator than there is.

 # Safety
 As there; `inputs` must be readable.
 */
enum FviStatus fvi_pid_tick_with(struct FviPid *controller, const struct FviPidInputs *inputs, float *output);

/*
 Sets the output by hand, from the next tick on, within limits and rate; the integral forgets.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED or FVI_STATUS_NOT_FINITE.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_pid_manual(struct FviPid *controller, float output);

/*
 Gives the output back to the law; the next tick has the output of the tick before.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_pid_automatic(struct FviPid *controller);

/*
 Changes the gains, from the next tick on; `bumpless` of the settings says what must not move. In the
 series form they are kp, 1/T_i and T_d.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED, FVI_STATUS_NOT_INITIALISED, FVI_STATUS_NOT_FINITE, or
 FVI_STATUS_OUT_OF_RANGE if a gain is not allowed, or a derivative lacks its memory.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_pid_set_gains(struct FviPid *controller, float kp, float ki, float kd);

/*
 Forgets everything; the gains stay.

 Returns FVI_STATUS_NULL, FVI_STATUS_MISALIGNED or FVI_STATUS_NOT_INITIALISED.

 # Safety
 `controller` must be zeroed or set up.
 */
enum FviStatus fvi_pid_reset(struct FviPid *controller);

/*
 Saves a controller with all that its memories hold, as fvi_operator_save does an operator. The law is not
 part of it.

 # Safety
 `controller` must be zeroed or set up, `capacity` bytes and `written` writable.
 */
enum FviStatus fvi_pid_save(const struct FviPid *controller, uint8_t *bytes, size_t capacity, size_t *written);

/*
 Restores what fvi_pid_save wrote, into a controller that was set up alike, as fvi_operator_restore does an
 operator.

 # Safety
 `controller` must be zeroed or set up, `count` bytes readable.
 */
enum FviStatus fvi_pid_restore(struct FviPid *controller, const uint8_t *bytes, size_t count);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* FVI_H */
