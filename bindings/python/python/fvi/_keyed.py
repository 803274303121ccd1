"""Values that stand for a table of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fvi import _arrays
from fvi._errors import InputError
from fvi._types import Real


class Keyed:
    """A value that is a table of a scenario, as a kernel is."""

    def __init__(self, **keys: Any) -> None:
        self._keys = keys

    @property
    def keys(self) -> dict[str, Any]:
        """The keys of the table in a scenario."""
        return dict(self._keys)


def keys_of(name: str, given: Any) -> dict[str, Any]:
    """The keys of a kernel, or of a mapping with the keys of one."""
    if isinstance(given, Keyed):
        return given.keys
    if isinstance(given, Mapping):
        return dict(given)
    raise InputError(f"{name} = {given!r}: a fvi.Kernel is needed", name, repr(given))


def exponent_or_kernel(exponent: Real | None, kernel: Any) -> tuple[float | None, dict[str, Any] | None]:
    """One of the two, checked."""
    if (exponent is None) == (kernel is None):
        message = "exponent, kernel: one of them is needed" if exponent is None else "exponent cannot stand beside kernel"
        raise InputError(message, "exponent", repr(exponent))
    if kernel is None:
        return _arrays.real("exponent", exponent), None
    return None, keys_of("kernel", kernel)
