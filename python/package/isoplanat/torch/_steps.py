"""Steps of a lens by the gradient of one's own loss, as ``isoplanat design`` takes them."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import torch

from .._isoplanat import Steps
from ._layer import LensLayer


class Step(NamedTuple):
    """What a step did.

    Attributes
    ----------
    moved : bool
        False: no lens was found in that direction; the layer is as it was, and the next step is shorter.
    length_mm : float
        How far the rays moved on the sensor, root mean square, mm.
    signal : float
        How much the last gradients agree, 0 to 1.
    violation : float
        Largest violation of what is held, before the step, relative to its bound or to 1.
    held_by : list of str
        What held the step back.
    """

    moved: bool
    length_mm: float
    signal: float
    violation: float
    held_by: list[str]


class LensSteps(torch.optim.Optimizer):
    """An optimizer of a `LensLayer`'s numbers that measures steps by what they do to rays, and keeps the lens a lens.

    With the Jacobian of the rays' landings a step moves rays by ``lr`` mm, root mean square, where gradients agree, and by less where they do not. What is held is
    linear in each step, exactly; lenses through which rays do not pass are not entered. Curvatures, thicknesses and aspheres need no rates of
    their own.

    Parameters
    ----------
    layer : LensLayer
    lr : float
        How far rays move in a step at most, mm. `torch.optim.lr_scheduler` changes it as any rate.
    hold : sequence of str
        "focal_length", "back_focus", "f_number": stay what they are. "track": the lens grows no longer (it may grow to 1.2 of its length otherwise).
        "distortion": at the frame's corner within 8 %, or within 2 % of the start's where that is beyond.
    constraints : dict, optional
        Bounds of quantities by name, as in `Lens.optimize`: ``{"track": (None, 60.0), "surface[*].edge": (0.5, None)}``. They replace what `hold` says.
    bounds : dict, optional
        Bounds of numbers by name or pattern.

    Edges, slopes and openings of the surfaces are kept makeable besides; `held` lists everything.

    Attributes
    ----------
    last : Step or None
    """

    def __init__(
        self,
        layer: LensLayer,
        lr: float = 2e-3,
        *,
        hold: str | Sequence[str] = ("focal_length", "track", "distortion"),
        constraints: Mapping[str, Any] | None = None,
        bounds: Mapping[str, Any] | None = None,
    ) -> None:
        if not isinstance(layer, LensLayer):
            raise TypeError(f"layer: {type(layer).__name__}; a LensLayer, whose numbers move")
        super().__init__(list(layer.numbers.values()), {"lr": lr})
        self._layer = layer
        values = layer._values().detach().cpu().numpy()
        self._steps = Steps(layer._core, values, hold, dict(constraints or {}), dict(bounds or {}))
        self.last: Step | None = None

    @property
    def held(self) -> dict[str, tuple[float, float]]:
        """(lowest, highest) of what is held, by name."""
        return {name: (low, high) for name, low, high in self._steps.held}

    def violation(self) -> float | None:
        """The largest violation of what is held, relative to its bound or to 1; None where rays do not get through the lens."""
        return self._steps.violation(self._layer._core, self._layer._values().detach().cpu().numpy())

    @torch.no_grad()
    def step(self, closure: Callable[[], Any] | None = None) -> Any:  # type: ignore[override,unused-ignore]
        """One step; ``last`` says what it did. Raises ValueError where the numbers were set to what is no lens."""
        loss = None
        if closure is not None:
            with torch.enable_grad():  # type: ignore[no-untyped-call,unused-ignore]
                loss = closure()
        layer = self._layer
        values, gradient = layer._values().detach(), layer._gradient()
        found = self._steps.step(layer._core, values.cpu().numpy(), gradient.cpu().numpy(), float(self.param_groups[0]["lr"]))
        if found is None:
            self.last = Step(False, 0.0, 0.0, float("nan"), [])
        else:
            core, moved, length, signal, violation, held_by = found
            layer._settle(core, torch.from_numpy(moved).to(values.device))
            self.last = Step(True, length, signal, violation, held_by)
        return loss

    def state_dict(self) -> dict[str, Any]:
        """As of any optimizer, with what steps remember."""
        return {**super().state_dict(), "memory": self._steps.memory}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on with what ``state_dict`` gave."""
        state = dict(state_dict)
        first, second, steps, reach = state.pop("memory")
        super().load_state_dict(state)
        self._steps.remember(list(first), second, steps, reach)
