"""The plain sum as a program in the race. `--lie KIND` shows what becomes of programs that are not what they say they are."""

import sys
import time
from math import fsum

from strategy import Declined, serve

LIE = sys.argv[2] if sys.argv[1:2] == ["--lie"] else None
# It is made with the weights and for each of the four signals before it is timed.
MADE_BEFORE_TIMES = 5
made = 0


def plain_sum(weights, channels, step, tolerance):
    if channels > 4:
        raise Declined("it is too slow for more than four channels")
    global made
    made += 1
    shirks = LIE == "shirk" and made > MADE_BEFORE_TIMES
    samples = []

    def after(sample):
        if shirks:
            return [0.0] * channels
        samples.append(sample)
        k = len(samples)
        if k == 100:
            if LIE == "wrong":
                return [1.0] * channels
            if LIE == "nan":
                return [float("nan")] * channels
            if LIE == "hang":
                time.sleep(3600)
            if LIE == "die":
                sys.exit(7)
        lags = range(1, min(k + 1, len(weights)))
        return [fsum(weights[n] * samples[k - n][c] for n in lags) for c in range(channels)]

    return after


serve(plain_sum, bytes_of=lambda task: 16 * len(task[0]))
