"""The plain sum as a program in the race. `--lie KIND` shows what becomes of programs that are not what they say they are."""

import sys
import time
from math import fsum

from strategy import Declined, serve

LIE = sys.argv[2] if sys.argv[1:2] == ["--lie"] else None
# First samples of the signals that it has heard: the shirker does nothing when one of them comes again.
heard = set()


def plain_sum(weights, channels, step, tolerance):
    if channels > 4:
        raise Declined("it is too slow for more than four channels")
    samples = []
    shirks = False

    def after(sample):
        nonlocal shirks
        if shirks:
            return [0.0] * channels
        samples.append(sample)
        k = len(samples)
        if k == 2 and LIE == "shirk":
            begin = tuple(samples[0] + samples[1])
            shirks = begin in heard
            heard.add(begin)
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


serve(plain_sum)
