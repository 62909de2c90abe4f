"""How the simulator's loops are compiled.

They allocate nothing, so they do without numba's run time. With it references to arrays are counted, which takes longer
than following a ray: each array that goes into a small function, or out of a tuple, costs two atomic operations. What a
loop needs for itself its caller allocates.
"""

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., Any])


def loop(function: Function) -> Function:
    """Compile a loop that allocates nothing."""
    return _compiled(function, fastmath=False)


def loop_without_nan(function: Function) -> Function:
    """The same for numbers that are never NaN: minimum and maximum are single instructions then."""
    return _compiled(function, fastmath={"nnan", "nsz"})


def loop_in_any_order(function: Function) -> Function:
    """The same where sums may be taken in any order, by many lanes at once."""
    return _compiled(function, fastmath=True)


def _compiled(function: Function, *, fastmath: bool | set[str]) -> Function:
    # numba's own stubs do not know of the option that leaves out its run time.
    options: dict[str, Any] = {"cache": True, "nogil": True, "fastmath": fastmath, "_nrt": False}
    return cast(Function, numba.njit(**options)(function))
