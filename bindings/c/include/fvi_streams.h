/* C interface of fvi for streams: convolution of an endless stream with finite responses, in blocks of any size, in single
 * (_f32) and double precision (_f64).
 *
 * Memory is allocated where a convolver is made and where responses are prepared, never where a block is processed or responses are
 * exchanged. Every call that can be wrong returns a status; any status but FVI_STREAM_STATUS_OK means that the call has changed nothing.
 *
 * Generated; do not edit. */

#ifndef FVI_STREAMS_H
#define FVI_STREAMS_H

#include <stddef.h>
#include <stdint.h>

/*
 The status returned by a call. Any status but FVI_STREAM_STATUS_OK means that the call has changed
 nothing.
 */
typedef enum FviStreamStatus {
  /*
   Success.
   */
  FVI_STREAM_STATUS_OK = 0,
  /*
   A pointer is NULL that must not be.
   */
  FVI_STREAM_STATUS_NULL = 1,
  /*
   A pointer is not aligned as its type requires.
   */
  FVI_STREAM_STATUS_MISALIGNED = 2,
  /*
   A number of samples, bytes or responses is larger than any array can be.
   */
  FVI_STREAM_STATUS_OUT_OF_RANGE = 3,
  /*
   The latency is longer than 16777216 samples.
   */
  FVI_STREAM_STATUS_LATENCY = 4,
  /*
   The length to be planned for is longer than 268435456 samples.
   */
  FVI_STREAM_STATUS_LONGEST = 5,
  /*
   There is no input, no output, or no response with a sample.
   */
  FVI_STREAM_STATUS_NO_RESPONSE = 6,
  /*
   A response is longer than 268435456 samples, or than the convolver was planned for.
   */
  FVI_STREAM_STATUS_RESPONSE_TOO_LONG = 7,
  /*
   A sample of a response is infinite or NaN.
   */
  FVI_STREAM_STATUS_RESPONSE_NOT_FINITE = 8,
  /*
   The responses are not from as many inputs to as many outputs as those of the convolver.
   */
  FVI_STREAM_STATUS_CHANNELS = 9,
  /*
   A sample of the stream is infinite or NaN.
   */
  FVI_STREAM_STATUS_SAMPLE_NOT_FINITE = 10,
  /*
   An exchange is under way.
   */
  FVI_STREAM_STATUS_BUSY = 11,
  /*
   The responses were prepared for a convolver of another shape, stream or precision.
   */
  FVI_STREAM_STATUS_FOREIGN = 12,
  /*
   There are no responses: the place is empty, or none have been put out of use.
   */
  FVI_STREAM_STATUS_EMPTY = 13,
  /*
   There are responses in the place already.
   */
  FVI_STREAM_STATUS_OCCUPIED = 14,
  /*
   The buffer is smaller than the state.
   */
  FVI_STREAM_STATUS_WRONG_SIZE = 15,
  /*
   Saved bytes are incomplete, damaged, or the state of another convolver.
   */
  FVI_STREAM_STATUS_WRONG_STATE = 16,
} FviStreamStatus;

/*
 A convolver in single precision:

 y_o(k) = Σ_i Σ_n w_oi(n) x_i(k − latency − n) ,     x_i(j) = 0 for j < 0.

 The error is a few units of rounding of Σ|w| max|x|, however long the stream is. One thread at a time may
 use it.
 */
typedef struct FviConvolverF32 FviConvolverF32;

/*
 A convolver in double precision:

 y_o(k) = Σ_i Σ_n w_oi(n) x_i(k − latency − n) ,     x_i(j) = 0 for j < 0.

 The error is a few units of rounding of Σ|w| max|x|, however long the stream is. One thread at a time may
 use it.
 */
typedef struct FviConvolverF64 FviConvolverF64;

/*
 A place for responses that are ready for a convolver. One thread at a time may use it.
 */
typedef struct FviPreparedF32 FviPreparedF32;

/*
 A place for responses that are ready for a convolver. One thread at a time may use it.
 */
typedef struct FviPreparedF64 FviPreparedF64;

/*
 What makes responses ready for an exchange, on any thread; several threads may use it at the same time.
 */
typedef struct FviPreparerF32 FviPreparerF32;

/*
 What makes responses ready for an exchange, on any thread; several threads may use it at the same time.
 */
typedef struct FviPreparerF64 FviPreparerF64;

/*
 A finite response; with no samples it stands for no response, which costs nothing.
 */
typedef struct FviResponseF32 {
  /*
   Its samples w(0), w(1), …; they are copied.
   */
  const float *samples;
  /*
   Their number, at most 268435456.
   */
  size_t count;
} FviResponseF32;

/*
 What is known about a stream before it begins.
 */
typedef struct FviStream {
  /*
   Samples by which outputs come later than by the definition: y(k) is the value for k − latency. With a
   latency of the length of a block there is little or nothing to sum directly.
   */
  size_t latency;
  /*
   Samples of a call, if all have as many, else 0. Other calls remain possible, but may cost more.
   */
  size_t block;
  /*
   Samples of the longest response that will be exchanged for the present ones, if it is longer; else 0.
   */
  size_t longest;
} FviStream;

/*
 What a convolver is, and where it is.
 */
typedef struct FviConvolverFacts {
  /*
   Number of inputs.
   */
  size_t inputs;
  /*
   Number of outputs.
   */
  size_t outputs;
  /*
   Samples by which outputs come later than by the definition of the convolution.
   */
  size_t latency;
  /*
   Samples of the longest response that can be exchanged for the present ones.
   */
  size_t longest;
  /*
   Bytes of tables and state.
   */
  size_t bytes;
  /*
   Samples taken since the beginning.
   */
  uint64_t taken;
  /*
   Samples until the exchange under way has ended; 0 if there is none.
   */
  uint64_t exchange_left;
  /*
   Number of blocks that were not done when they were due, and were then finished at once. The schedule
   keeps it at zero.
   */
  uint64_t overruns;
} FviConvolverFacts;

/*
 A finite response; with no samples it stands for no response, which costs nothing.
 */
typedef struct FviResponseF64 {
  /*
   Its samples w(0), w(1), …; they are copied.
   */
  const double *samples;
  /*
   Their number, at most 268435456.
   */
  size_t count;
} FviResponseF64;

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

/*
 A short English text for a status; an unknown one has a text as well. Never NULL.
 */
const char *fvi_stream_status_text(int32_t status);

/*
 Makes a convolver from `inputs` to `outputs` channels, and writes its address to `convolver`. Everything
 is planned and allocated here; memory that cannot be had ends the program.

 `responses` is a matrix, row by row: the responses of input 0 to all outputs, then those of input 1, ….
 They are copied. With as many inputs as outputs and the same array for each channel and nothing else, that
 one is transformed and stored once.

 Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, _LATENCY, _LONGEST, _NO_RESPONSE,
 _RESPONSE_TOO_LONG or _RESPONSE_NOT_FINITE; then nothing is written. fvi_convolver_free_f32 frees it.

 # Safety
 `responses` must be `inputs` times `outputs` responses, each with as many samples as it says; `stream`
 must be readable, `convolver` writable.
 */
enum FviStreamStatus fvi_convolver_new_f32(const struct FviResponseF32 *responses,
                                           size_t inputs,
                                           size_t outputs,
                                           const struct FviStream *stream,
                                           struct FviConvolverF32 **convolver);

/*
 Frees a convolver; NULL is ignored.

 # Safety
 `convolver` must be NULL or come from fvi_convolver_new_f32, and not be used afterwards.
 */
void fvi_convolver_free_f32(struct FviConvolverF32 *convolver);

/*
 Takes the next `samples` samples of each input and writes as many of each output: `inputs` and `outputs`
 are the addresses of one array for each of them. An output may be the same array as an input, or lie
 apart from all. Does not allocate, free, lock or wait.

 Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, or _SAMPLE_NOT_FINITE; then neither convolver
 nor outputs have changed.

 # Safety
 `convolver` must come from fvi_convolver_new_f32; there must be as many arrays as it has inputs and
 outputs, each of them with room for `samples` numbers, those of the inputs readable, those of the outputs
 writable.
 */
enum FviStreamStatus fvi_convolver_process_f32(struct FviConvolverF32 *convolver,
                                               const float *const *inputs,
                                               float *const *outputs,
                                               size_t samples);

/*
 Writes what the convolver is, and where it is, to `facts`.

 Returns FVI_STREAM_STATUS_NULL or _MISALIGNED.

 # Safety
 `convolver` must come from fvi_convolver_new_f32, `facts` be writable.
 */
enum FviStreamStatus fvi_convolver_facts_f32(const struct FviConvolverF32 *convolver, struct FviConvolverFacts *facts);

/*
 Makes what prepares responses for this convolver, and writes its address to `preparer`; to be called on
 the thread that uses the convolver, before the stream begins. It may outlive the convolver.

 Returns FVI_STREAM_STATUS_NULL or _MISALIGNED; then nothing is written. fvi_preparer_free_f32 frees it.

 # Safety
 `convolver` must come from fvi_convolver_new_f32, `preparer` be writable.
 */
enum FviStreamStatus fvi_preparer_new_f32(const struct FviConvolverF32 *convolver, struct FviPreparerF32 **preparer);

/*
 Frees what prepares responses; NULL is ignored.

 # Safety
 `preparer` must be NULL or come from fvi_preparer_new_f32, and not be used afterwards.
 */
void fvi_preparer_free_f32(struct FviPreparerF32 *preparer);

/*
 Makes responses ready for an exchange, on any thread, and writes the address of their place to `prepared`;
 `responses`, `inputs` and `outputs` as for fvi_convolver_new_f32.

 Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, _NO_RESPONSE, _RESPONSE_TOO_LONG,
 _RESPONSE_NOT_FINITE, or _CHANNELS if the convolver has others; then nothing is written.
 fvi_prepared_free_f32 frees it.

 # Safety
 `preparer` must come from fvi_preparer_new_f32; the rest as for fvi_convolver_new_f32.
 */
enum FviStreamStatus fvi_preparer_prepare_f32(const struct FviPreparerF32 *preparer,
                                              const struct FviResponseF32 *responses,
                                              size_t inputs,
                                              size_t outputs,
                                              struct FviPreparedF32 **prepared);

/*
 Frees a place, with the responses in it; NULL is ignored. It frees memory: not for the thread of a stream.

 # Safety
 `prepared` must be NULL or come from fvi_preparer_prepare_f32, and not be used afterwards.
 */
void fvi_prepared_free_f32(struct FviPreparedF32 *prepared);

/*
 Begins to exchange the responses: from the next sample on, with i = 0, 1, …,

 y = (1 − g) y_old + g y_new ,     g = min(1, i/fade) ,

 where y_old and y_new are the convolutions of the whole stream with the responses before and after. Takes
 the responses out of their place; what an earlier exchange has put out of use is in it afterwards, else it
 is empty. `begins_in`, unless NULL, receives the samples until the fade begins, here 0.

 The blocks under way are computed for the new responses at once, which for long responses takes as long as
 some blocks of audio; fvi_convolver_exchange_evenly_f32 does not. Neither allocates, frees, locks or
 waits.

 Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _EMPTY if there is nothing in the place, _BUSY or _FOREIGN;
 then nothing has changed, and the responses are still in their place.

 # Safety
 `convolver` must come from fvi_convolver_new_f32, `prepared` from fvi_preparer_prepare_f32; `begins_in`
 must be NULL or writable.
 */
enum FviStreamStatus fvi_convolver_exchange_f32(struct FviConvolverF32 *convolver,
                                                struct FviPreparedF32 *prepared,
                                                size_t fade,
                                                uint64_t *begins_in);

/*
 The same without any work here: the fade begins when the outputs of the new responses have been computed
 along with those of the old ones, after one to two blocks of the coarsest stage; `begins_in` receives how
 many samples these are. Until it has ended the products of spectra cost twice as much.

 Returns what fvi_convolver_exchange_f32 returns.

 # Safety
 As for fvi_convolver_exchange_f32.
 */
enum FviStreamStatus fvi_convolver_exchange_evenly_f32(struct FviConvolverF32 *convolver,
                                                       struct FviPreparedF32 *prepared,
                                                       size_t fade,
                                                       uint64_t *begins_in);

/*
 Moves the responses that an exchange has put out of use, after its fade has ended, to an empty place, to
 be freed on another thread or used again.

 Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OCCUPIED if the place is not empty, or _EMPTY if none are
 out of use; then nothing has changed.

 # Safety
 As for fvi_convolver_exchange_f32.
 */
enum FviStreamStatus fvi_convolver_take_retired_f32(struct FviConvolverF32 *convolver, struct FviPreparedF32 *prepared);

/*
 Forgets all samples; an exchange under way ends.

 Returns FVI_STREAM_STATUS_NULL or _MISALIGNED.

 # Safety
 `convolver` must come from fvi_convolver_new_f32.
 */
enum FviStreamStatus fvi_convolver_clear_f32(struct FviConvolverF32 *convolver);

/*
 Saves a convolver: writes its state, the last samples of each input, to `bytes` and the number of bytes to
 `written`. With a capacity of 0 only the number of bytes that are needed at present is written; it grows
 until as many samples have come as the longest response has, and some more.

 The bytes are the same on every machine. They contain no checksum; where stored bits can change, add one.
 Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, or _WRONG_SIZE if the capacity is too small;
 then nothing is written.

 # Safety
 `convolver` must come from fvi_convolver_new_f32, `capacity` bytes and `written` be writable.
 */
enum FviStreamStatus fvi_convolver_save_f32(const struct FviConvolverF32 *convolver,
                                            uint8_t *bytes,
                                            size_t capacity,
                                            size_t *written);

/*
 Restores what fvi_convolver_save_f32 wrote, into a convolver with the same responses and the same stream:
 it then continues bit-identically, whatever it did before. A state saved during an exchange needs a
 convolver in which an exchange for the same responses is under way. Bytes after the state, up to `count`,
 are ignored.

 Returns FVI_STREAM_STATUS_NULL, _MISALIGNED, _OUT_OF_RANGE, or _WRONG_STATE if the bytes are not the state
 of such a convolver, which is then unchanged.

 # Safety
 `convolver` must come from fvi_convolver_new_f32, `count` bytes be readable.
 */
enum FviStreamStatus fvi_convolver_restore_f32(struct FviConvolverF32 *convolver, const uint8_t *bytes, size_t count);

/*
 As fvi_convolver_new_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_new_f32.
 */
enum FviStreamStatus fvi_convolver_new_f64(const struct FviResponseF64 *responses,
                                           size_t inputs,
                                           size_t outputs,
                                           const struct FviStream *stream,
                                           struct FviConvolverF64 **convolver);

/*
 As fvi_convolver_free_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_free_f32.
 */
void fvi_convolver_free_f64(struct FviConvolverF64 *convolver);

/*
 As fvi_convolver_process_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_process_f32.
 */
enum FviStreamStatus fvi_convolver_process_f64(struct FviConvolverF64 *convolver,
                                               const double *const *inputs,
                                               double *const *outputs,
                                               size_t samples);

/*
 As fvi_convolver_facts_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_facts_f32.
 */
enum FviStreamStatus fvi_convolver_facts_f64(const struct FviConvolverF64 *convolver, struct FviConvolverFacts *facts);

/*
 As fvi_preparer_new_f32, for a convolver in double precision.

 # Safety
 As for fvi_preparer_new_f32.
 */
enum FviStreamStatus fvi_preparer_new_f64(const struct FviConvolverF64 *convolver, struct FviPreparerF64 **preparer);

/*
 As fvi_preparer_free_f32, for a convolver in double precision.

 # Safety
 As for fvi_preparer_free_f32.
 */
void fvi_preparer_free_f64(struct FviPreparerF64 *preparer);

/*
 As fvi_preparer_prepare_f32, for a convolver in double precision.

 # Safety
 As for fvi_preparer_prepare_f32.
 */
enum FviStreamStatus fvi_preparer_prepare_f64(const struct FviPreparerF64 *preparer,
                                              const struct FviResponseF64 *responses,
                                              size_t inputs,
                                              size_t outputs,
                                              struct FviPreparedF64 **prepared);

/*
 As fvi_prepared_free_f32, for a convolver in double precision.

 # Safety
 As for fvi_prepared_free_f32.
 */
void fvi_prepared_free_f64(struct FviPreparedF64 *prepared);

/*
 As fvi_convolver_exchange_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_exchange_f32.
 */
enum FviStreamStatus fvi_convolver_exchange_f64(struct FviConvolverF64 *convolver,
                                                struct FviPreparedF64 *prepared,
                                                size_t fade,
                                                uint64_t *begins_in);

/*
 As fvi_convolver_exchange_evenly_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_exchange_evenly_f32.
 */
enum FviStreamStatus fvi_convolver_exchange_evenly_f64(struct FviConvolverF64 *convolver,
                                                       struct FviPreparedF64 *prepared,
                                                       size_t fade,
                                                       uint64_t *begins_in);

/*
 As fvi_convolver_take_retired_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_take_retired_f32.
 */
enum FviStreamStatus fvi_convolver_take_retired_f64(struct FviConvolverF64 *convolver, struct FviPreparedF64 *prepared);

/*
 As fvi_convolver_clear_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_clear_f32.
 */
enum FviStreamStatus fvi_convolver_clear_f64(struct FviConvolverF64 *convolver);

/*
 As fvi_convolver_save_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_save_f32.
 */
enum FviStreamStatus fvi_convolver_save_f64(const struct FviConvolverF64 *convolver,
                                            uint8_t *bytes,
                                            size_t capacity,
                                            size_t *written);

/*
 As fvi_convolver_restore_f32, for a convolver in double precision.

 # Safety
 As for fvi_convolver_restore_f32.
 */
enum FviStreamStatus fvi_convolver_restore_f64(struct FviConvolverF64 *convolver, const uint8_t *bytes, size_t count);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* FVI_STREAMS_H */
