"""Signals that ask a run to stop."""

from __future__ import annotations

import signal
import threading
from typing import Any


class Signals:
    """Records SIGINT, SIGTERM and SIGUSR1 instead of ending the process at once."""

    came = False
    name = ""

    def __enter__(self) -> Signals:
        self.before: dict[int, Any] = {}
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
                self.before[number] = signal.signal(number, self._note)
        return self

    def _note(self, number: int, _: Any) -> None:
        self.came, self.name = True, signal.Signals(number).name

    def __exit__(self, *_: object) -> None:
        for number, handler in self.before.items():
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
