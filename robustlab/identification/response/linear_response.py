"""A linear model's response to a record in windows."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from robustlab.arrays import Array, Indices
from robustlab.identification.response.response import Response, Stretch
from robustlab.identification.response.windowed_simulation import AT_ONCE, WindowResponses
from robustlab.statespace import StateSpaceModel


@dataclass(frozen=True, eq=False)
class LinearResponse:
    """A linear model matched with one record; its weight is one over the range of each output."""

    response: Response
    whole: Stretch
    pushes: Array | None = None  # rate of the states per unit of each added force, (n_x, n_forces)
    together: ClassVar[bool] = False

    @property
    def state_names(self) -> tuple[str, ...]:
        return self.response.model.state_names

    def responses(
        self, starts: Sequence[int] | Indices, length: int, added: Array | None = None
    ) -> Iterator[WindowResponses]:
        """Simulate windows of ``length`` samples in batches; ``added``: the forces of ``pushes``, (n, n_forces)."""
        whole, response, n_x = self.whole, self.response, self.response.n_states
        # The free response is the same in all windows of a uniform time base.
        shared = response.free_response(whole.t[:length]) if whole.is_uniform else None
        count = max(1, AT_ONCE // (length * whole.y.shape[1] * (1 + n_x)))
        for k in range(0, len(starts), count):
            chosen = np.asarray(starts[k : k + count], dtype=np.int64)
            parts = [whole.cut(int(a), int(a) + length) for a in chosen]
            y = np.stack([response.simulate(part.t, part.u, np.zeros(n_x)) for part in parts])
            free = np.stack([response.free_response(part.t) if shared is None else shared for part in parts])
            pushed = np.zeros((*y.shape, 0))
            if added is not None and self.pushes is not None:
                alone = [self._pushed(part.t, added[a : a + length]) for a, part in zip(chosen, parts, strict=True)]
                pushed = np.stack(alone)
            yield WindowResponses(chosen, y, np.zeros((len(chosen), n_x)), free, pushed)

    def _pushed(self, t: Array, forces: Array) -> Array:
        """Simulate the response to each force alone, (n, n_y, n_forces)."""
        model, found = self.response.model.select(outputs=self.response.output_names), []
        for push, d in zip((self.pushes if self.pushes is not None else forces[:0]).T, forces.T, strict=True):
            through = np.zeros((model.n_outputs, 1))
            alone = StateSpaceModel(model.A, push[:, None], model.C, through, 0.0, ["d"], model.outputs)
            found.append(Response(alone, self.response.outputs, ()).simulate(t, {"d": d}, np.zeros(model.n_states)))
        return np.stack(found, axis=2)
