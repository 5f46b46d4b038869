"""One function of many things, on the workers of Dask."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from specmap_cli.batch.cluster import Place, opened, require_dask
from specmap_cli.core.errors import NoResultError

Thing = TypeVar("Thing")
Result = TypeVar("Result")


def spread(
    place: Place, function: Callable[[Thing], Result], things: Sequence[Thing]
) -> list[Result]:
    """What a function says of each thing, in their order; both can be pickled.

    What the function raises is raised here. Raises UsageError where there are no workers,
    NoResultError where they are lost on the way.
    """
    require_dask()
    from distributed import KilledWorker
    from distributed.comm.core import CommClosedError

    with opened(place) as client:
        try:
            found: list[Result] = client.gather(client.map(function, things, pure=False))
            return found
        except (KilledWorker, CommClosedError) as error:
            raise NoResultError(
                f"the workers were lost ({type(error).__name__}): start them and run the same "
                "command again, or leave out --workers and --scheduler"
            ) from None
