"""What a program in a race of `fvi strategies` says and hears: lines over standard input and output.

    begin LENGTH CHANNELS STEP TOLERANCE
    weights w_0 w_1 …                       -> ready, or: declined REASON
    clear                                   -> ok
    push x_k of every channel               -> r_{k+1} of every channel, r_k = sum of w_n x_{k-n} over n >= 1

`serve` speaks them for anything that can be called: `make(weights, channels, step, tolerance)` returns a function from a
sample to the terms after it, both lists of as many numbers as there are channels.
"""

import sys


class Declined(Exception):
    """The strategy is not for this task; the message says why."""


def serve(make):
    """Answers until the race is over. After `clear` the function is made anew."""
    task = step = None
    for line in sys.stdin:
        word, *rest = line.split()
        if word == "begin":
            head = rest
        elif word == "weights":
            task = ([float(w) for w in rest], int(head[1]), float(head[2]), float(head[3]))
            try:
                step = make(*task)
                answer = "ready"
            except Declined as reason:
                answer = f"declined {reason}"
            print(answer, flush=True)
        elif word == "clear":
            step = make(*task)
            print("ok", flush=True)
        elif word == "push":
            # repr has the digits that lead back to the same number.
            print(*map(repr, step([float(x) for x in rest])), flush=True)
