"""Any load on the grasps of a data set: what the label protocol says of loads that the data set did not draw."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from aminn_base.read import AnyPath

from . import _core
from .config import SimulationConfig
from .errors import SimulationError
from .open_hand import OpenHand, open_hand
from .vary import theta_of

Array = NDArray[np.float64]
T = TypeVar("T")


def session_of(config: SimulationConfig, opened: OpenHand, simulator: _core.Simulator, grasp_id: int) -> _core.Session:
    """A grasp of a configuration's data set, in the engine, settled. Raises SimulationError where none can be made."""
    shard, index = divmod(grasp_id, config.shard_grasps)
    theta = theta_of(config, opened.hand, grasp_id)
    families = config.family_indices()
    try:
        return _core.Session(simulator, config.options(), config.seed, shard, index, grasp_id, families, theta)
    except RuntimeError as error:
        raise SimulationError(str(error)) from error


class ReplayedGrasp:
    """A settled grasp, bit by bit that of the data set, to be loaded as often as one likes."""

    def __init__(self, session: _core.Session) -> None:
        self.session = session
        self.state: dict[str, NDArray] = {k: v[0] for k, v in session.grasp().items()}
        """What /grasps has of it (`schema`), and its j_x and j_q."""

    @property
    def grasp_id(self) -> int:
        """Of the data set."""
        return int(self.state["grasp_id"])

    def load(self, w_e: ArrayLike) -> dict[str, NDArray]:
        """Fields of /samples for the load w_e (6: N, N.m, H) about the tool's origin, from the settled state each time.

        A load that the data set drew gives the numbers that it has.
        """
        w = np.ascontiguousarray(w_e, np.float64)
        if w.shape != (6,) or not np.isfinite(w).all():
            raise SimulationError(f"load: {w_e!r} is no wrench of 6 finite numbers")
        return {k: v[0] for k, v in self.session.load(w).items() if k != "noise"}


def replay(
    config: SimulationConfig,
    grasp_ids: Sequence[int],
    work: Callable[[ReplayedGrasp], T],
    threads: int = 1,
    hand: AnyPath | None = None,
) -> list[T]:
    """work(grasp) for grasps of the data set of a configuration, in the order of their ids here.

    Nothing of a data set is read: grasps follow from the configuration. `work` runs on several threads at once.
    hand: a hand file instead of the package's own.
    """
    opened = open_hand(hand)
    simulator = opened.simulator()
    with ThreadPoolExecutor(max(1, threads)) as pool:
        return list(pool.map(lambda i: work(ReplayedGrasp(session_of(config, opened, simulator, int(i)))), grasp_ids))
