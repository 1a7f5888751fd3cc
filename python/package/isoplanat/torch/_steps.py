"""Steps of a lens by the gradient of one's own loss, as ``isoplanat design`` takes them."""

import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import torch

from .._isoplanat import Steps
from ._layer import LensLayer


STILL = 3
"""Steps in a row that move nothing before that is told."""


class Step(NamedTuple):
    """What a step did.

    Attributes
    ----------
    moved : bool
        False: the layer is as it was; `held_by` says why. Where no lens was found in that direction the next step is shorter.
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
    their own. The gradient's scale does not matter, only how gradients agree: clipping its norm changes nothing. Numbers with ``requires_grad=False`` stay.
    A start that violates what is held is brought back first, by as much as that takes, which may be more than ``lr``. Three steps in a row that move nothing are
    warned of once, with the reason.

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
        if not isinstance(lr, int | float) or not 0 <= lr <= 10:
            raise ValueError(f"lr: {lr}; a number from 0 to 10 (mm)")
        self._whole = False
        super().__init__(list(layer.numbers.values()), {"lr": lr})
        self._whole = True
        self._layer = layer
        values = layer._values().detach().cpu().numpy()
        self._frozen = self._now_frozen()
        self._steps = Steps(layer._core, values, hold, dict(constraints or {}), dict(bounds or {}), self._frozen)
        self.last: Step | None = None
        self._still = 0

    def _stays(self, why: str) -> None:
        """A step that moved nothing."""
        self.last = Step(False, 0.0, 0.0, float("nan"), [why])
        self._still += 1
        if self._still == STILL:
            warnings.warn(f"LensSteps: {STILL} steps in a row moved nothing: {why}", stacklevel=4)

    def _now_frozen(self) -> list[str]:
        """Numbers that ask for no gradient: they stay."""
        kinds = self._layer.numbers
        return [name for kind, names in self._layer.names.items() if not kinds[kind].requires_grad for name in names]

    def add_param_group(self, param_group: dict[str, Any]) -> None:
        """Refused: the steps are those of one layer."""
        if self._whole:
            raise ValueError("param_group: another one; LensSteps moves one layer's numbers, other optimizers move others")
        super().add_param_group(param_group)

    def __reduce_ex__(self, protocol: Any) -> Any:
        raise TypeError("LensSteps is not copied or pickled; state_dict() is, and goes into a new one")

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
        layer, rate = self._layer, float(self.param_groups[0]["lr"])
        if self._now_frozen() != self._frozen:
            raise ValueError("layer: numbers were frozen or freed since; LensSteps made anew")
        values, gradient = layer._values().detach(), layer._gradient()
        if rate == 0:
            # As a schedule asks for.
            self.last = Step(False, 0.0, 0.0, float("nan"), ["no rate"])
            return loss
        if not bool(gradient.any()):
            self._stays("no gradient")
            return loss
        if not bool(torch.isfinite(gradient).all()):
            self._stays("a gradient that is not finite")
            return loss
        found = self._steps.step(layer._core, values.cpu().numpy(), gradient.cpu().numpy(), rate)
        if found is None:
            self._stays("no lens in that direction")
        else:
            core, moved, length, signal, violation, held_by = found
            layer._settle(core, torch.from_numpy(moved).to(values.device))
            self.last = Step(True, length, signal, violation, held_by)
            self._still = 0
        return loss

    def state_dict(self) -> dict[str, Any]:
        """As of any optimizer, with what steps remember."""
        return {**super().state_dict(), "memory": self._steps.memory, "names": self._layer._all_names}

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Goes on with what ``state_dict`` gave."""
        state = dict(state_dict)
        if state.pop("names", None) != self._layer._all_names or "memory" not in state:
            raise ValueError(f"state_dict: not of LensSteps of these numbers: {', '.join(self._layer._all_names)}")
        first, second, steps, reach = state.pop("memory")
        super().load_state_dict(state)
        self._steps.remember(list(first), second, steps, reach)
