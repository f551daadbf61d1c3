"""In which order to visit nodes on the way to a goal: dynamic programming over sets of visited nodes.

Held and Karp, "A dynamic programming approach to sequencing problems", J. SIAM 10 (1962), section 2; a place here is a
node together with the heading at which it is reached, because the next turn depends on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

MAX_VISITS = 12


def cheapest_order(
    start: int,
    arrivals: Sequence[Sequence[int]],
    ends: Sequence[int],
    costs_from: Callable[[int], Mapping[int, float]],
    in_order: bool,
) -> list[int] | None:
    """The states at which the cheapest tour stops: start, one of each stop's `arrivals`, one of `ends`; None: no tour.

    arrivals: for each stop the states in which it can be reached, as many for each. costs_from: costs from a state to
    every state that can be reached from it. in_order: the stops keep their order, else the best is found.
    """
    stops, ways = len(arrivals), len(arrivals[0])
    flat = [state for stop in arrivals for state in stop]
    first = costs_from(start)
    onward = [costs_from(state) for state in flat]
    # legs[a, b]: from arrival a to arrival b; last[a]: from arrival a to the nearest end
    legs = np.array([[costs.get(state, np.inf) for state in flat] for costs in onward])
    last_all = np.array([[costs.get(end, np.inf) for end in ends] for costs in onward])
    last = last_all.min(axis=1)

    best = np.full((1 << stops, stops * ways), np.inf)
    before = np.full((1 << stops, stops * ways), -1, dtype=np.int32)
    for stop in range(1 if in_order else stops):
        here = slice(stop * ways, (stop + 1) * ways)
        best[1 << stop, here] = [first.get(state, np.inf) for state in flat[here]]
    for done in range(1, 1 << stops):
        if not np.isfinite(best[done]).any():
            continue
        for stop in range(stops):
            if done >> stop & 1 or (in_order and done != (1 << stop) - 1):
                continue
            here = slice(stop * ways, (stop + 1) * ways)
            cost: NDArray[np.float64] = best[done][:, None] + legs[:, here]
            best[done | 1 << stop, here] = cost.min(axis=0)
            before[done | 1 << stop, here] = cost.argmin(axis=0)
    done = (1 << stops) - 1
    total = best[done] + last
    at = int(total.argmin())
    if not np.isfinite(total[at]):
        return None
    order = [ends[int(last_all[at].argmin())]]
    while at >= 0:
        order.append(flat[at])
        done, at = done & ~(1 << at // ways), int(before[done, at])
    return [start, *reversed(order)]
