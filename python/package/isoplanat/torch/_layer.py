"""A lens as a layer of PyTorch: what it makes of patches of scenes, with the gradient of one's own loss by the lens's numbers."""

from collections.abc import Iterable, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import nn
from torch.autograd.function import once_differentiable

from .._isoplanat import Frame, Layer, Lens
from .._placed import Placed, pairs, which
from ._numbers import Numbers

# Share of the light that kernels may miss before they are laid out anew.
MOST_LOST = 0.1


class Fineness(NamedTuple):
    """How near a layer's gradient is to that of converged rendering, for a squared difference of captures and truths.

    Attributes
    ----------
    error : float
        Distance of the gradients from the converged ones, patch by patch, root mean square over theirs.
    noise : float
        Part of the patches' gradients that is not common to them: an error well below it moves no training.
    holds : bool
        Whether the error is at most 5 %, and a tenth of the noise; where none is, the finest settings are taken.
    """

    error: float
    noise: float
    holds: bool


class _Through(torch.autograd.Function):
    """Numbers and scenes to captures and truths; constant memory beside the patches' own."""

    @staticmethod
    def forward(
        ctx: Any,
        values: torch.Tensor,
        scenes: torch.Tensor,
        core: Layer,
        distances: list[int],
        places: list[tuple[int, int]],
        margin: int,
        shifts: list[tuple[float, float]] | None,
        held: bool,
        told: list[float],
    ) -> tuple[torch.Tensor, ...]:
        given = scenes.detach().cpu().contiguous().numpy()
        *all_of_them, ctx.record = core.record(values.detach().cpu().numpy(), given, distances, places, margin, shifts, held)
        ctx.device = values.device
        told.append(ctx.record.light)
        return tuple(torch.from_numpy(picture).to(scenes.device) for picture in all_of_them)

    @staticmethod
    @once_differentiable  # type: ignore[untyped-decorator,unused-ignore]
    def backward(ctx: Any, *pictures_bar: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        bars = [bar.detach().cpu().contiguous().numpy() for bar in pictures_bar]
        return torch.from_numpy(ctx.record.vjp(*bars)).to(ctx.device), None, None, None, None, None, None, None, None


class LensLayer(Placed, Numbers):
    """Patches of scenes through a lens whose numbers are trained: ``captures, truths = layer(scenes, distance_mm, place)``.

    Parameters
    ----------
    lens : Lens
    frame : Frame, optional
        The lens's own raster where left out.
    distances_mm : float or sequence of float, optional
        Object distances that scenes may stand at; the lens's own where left out.
    trainable : str or sequence of str
        Names or patterns of the lens's numbers, such as "surface[*].curvature" or "surface[2].a4".
    illuminant : str, optional
        As of `isoplanat.render`.
    diffraction : "off", "approximate" or "on"
        Kernels of rays; of rays, convolved with the open pupil's diffraction; of scalar waves.
    replan_every : int
        After so many forward passes in training, kernels are laid out anew for the lens as it is by then. Scenes are placed before the lens as it is at every
        pass, as ``isoplanat design`` places them; the gradient is that of scenes and kernels that stay where they are. 0: all stays where it is, as a function of the numbers
        should, until `replan`. In evaluation (``layer.eval()``) all is laid out anew whenever the numbers have changed, and in training where a tenth
        of the light or more would be lost.

    Attributes
    ----------
    numbers : torch.nn.ParameterDict
        The trained numbers by kind ("curvature", "thickness", …), float64 [n], in mm, 1/mm and so on. They stay float64, whatever the module is cast to.
    names : dict of list of str
        Their names, kind by kind, as in `Lens.parameters`.
    """

    def __init__(
        self,
        lens: Lens,
        frame: Frame | None = None,
        *,
        distances_mm: float | Sequence[float] | None = None,
        trainable: str | Sequence[str] = ("surface[*].curvature",),
        illuminant: str | None = None,
        diffraction: str | bool = "off",
        replan_every: int = 25,
    ) -> None:
        core = Layer(lens, frame, distances_mm, trainable, illuminant, diffraction=diffraction)
        super().__init__(core.names, core.values, replan_every)
        self._core = core
        # The lens that the layout is for.
        self._planned_lens = core.base
        # The lens that settings were chosen for, its numbers, and the settings.
        self._tuned: tuple[str, list[float], str] | None = None

    @property
    def lens(self) -> Lens:
        """The lens as it is now. Raises ValueError where its numbers are no lens."""
        return self._core.lens(self._values().detach().cpu().numpy())

    def replan(self) -> None:
        """Lays kernels out for the lens as it is now, and places scenes before it. Raises ValueError where its numbers are no lens; they go back then, as in
        `forward`."""
        values = self._values().detach()
        try:
            self._core = self._core.replanned(values.cpu().numpy())
        except ValueError as error:
            raise self._gone_back(error) from None
        self._passes, self._planned, self._planned_lens = 0, values.clone(), self._core.base

    def tune(
        self, scenes: torch.Tensor, distance_mm: Any = None, place: Any = None, *, margin: int = 0, shift: Any = None
    ) -> Fineness:
        """Renders by the coarsest settings of a ladder whose gradient is near enough on these patches, as ``isoplanat design`` chooses its own, and says how near that is.

        Until then the settings are the third of six. A batch of a training is enough; half a dozen patches of 96² take seconds. Wide blur asks for finer settings, and
        as a lens gets sharper others do: tune again now and then. Arguments are those of `forward`; kernels are laid out anew.
        """
        given, depths, places, shifts = self._asked(scenes, distance_mm, place, margin, shift)
        values = self._values().detach()
        texels = given.detach().float().cpu().contiguous().numpy()
        self._core, error, noise, holds = self._core.tuned(values.cpu().numpy(), texels, depths, places, margin, shifts)
        self._passes, self._planned, self._planned_lens = 0, values.clone(), self._core.base
        self._tuned = (self._core.base.to_toml(), values.tolist(), self._core.settings)
        return Fineness(error, noise, holds)

    def _settle(self, core: Layer, values: torch.Tensor) -> None:
        """Takes the lens that a step found: its numbers, and surfaces that were opened for its light."""
        self._core = core
        self._set(values)

    def _which(self, distance_mm: Any, count: int) -> list[int]:
        known = self.distances_mm
        if distance_mm is None:
            asked = [known[0]] * count
        else:
            try:
                one = isinstance(distance_mm, Real) or getattr(distance_mm, "ndim", None) == 0
                asked = [float(distance_mm)] * count if one else [float(d) for d in distance_mm]
            except (TypeError, ValueError):
                raise ValueError(f"distance_mm: {distance_mm!r}; a number of mm for all scenes, or one for each") from None
        return which(known, asked)

    @torch.compiler.disable  # type: ignore[untyped-decorator,unused-ignore]
    def forward(
        self,
        scenes: torch.Tensor,
        distance_mm: Any = None,
        place: Any = None,
        *,
        margin: int = 0,
        shift: Any = None,
        illumination: bool = False,
    ) -> tuple[torch.Tensor, ...]:
        """Captures and truths, both [B, 3, H - 2 margin, W - 2 margin], on the scenes' device.

        Parameters
        ----------
        scenes : tensor [B, 3, H, W]
            Linear light, upright; a texel is a pixel in the middle of the patch; texels are kept as float32. Scenes of float64 are rendered in
            float64, all others in float32. They have no gradient here. What lies beyond a scene goes on with its border.
        distance_mm : float, or tensor or sequence [B], optional
            Each one of the layer's distances; the first where left out.
        place : tensor or sequence [B, 2], optional
            Row and column of each patch's first pixel in the frame; the middle where left out.
        margin : int
            Texels on each side that only the blur sees.
        shift : tensor or sequence [B, 2], optional
            Texels down and across from each scene's middle to what its patch's middle sees. Half a texel where left out: a pixel there sees where four texels meet. Were
            texels laid on pixels, whatever moves a scene would soften it, and a loss would gain by moving it.
        illumination : bool
            A third tensor, of the same shape: how the lens dims the capture, 1 on the axis. `Sensor` makes its flat field of it.
        """
        given, depths, places, shifts = self._asked(scenes, distance_mm, place, margin, shift)
        self._follow()
        values, light = self._values(), list[float]()
        held = not self.training or self.replan_every == 0
        if len(values) != len(self._all_names):
            raise ValueError(f"numbers: {len(values)}; {len(self._all_names)}, as `names` lists them")
        with torch.autocast(scenes.device.type, enabled=False):
            try:
                arguments = (depths, places, margin, shifts, held, light)
                through: tuple[torch.Tensor, ...] = _Through.apply(values, given, self._core, *arguments)  # type: ignore[no-untyped-call,unused-ignore]
                # So far from the lens that kernels were laid out for that they miss its light.
                if not abs(light[-1] - 1) <= MOST_LOST and not self._is_planned():
                    self.replan()
                    through = _Through.apply(values, given, self._core, *arguments)  # type: ignore[no-untyped-call,unused-ignore]
            except ValueError as error:
                if self._stands(values):
                    raise
                raise self._gone_back(error) from None
        self._valid = values.detach().clone()
        return through if illumination else through[:2]

    def _asked(
        self, scenes: torch.Tensor, distance_mm: Any, place: Any, margin: int, shift: Any
    ) -> tuple[torch.Tensor, list[int], list[tuple[int, int]], list[tuple[float, float]] | None]:
        """Scenes of the type that they are rendered in, their distances by number, places, shifts."""
        if not isinstance(scenes, torch.Tensor):
            raise TypeError(f"scenes: {type(scenes).__name__}; a tensor, as torch.from_numpy makes it of an array")
        rows, columns = self._patch(scenes.shape, margin)
        if scenes.requires_grad:
            raise ValueError("scenes: they ask for a gradient, and have none here; scenes.detach()")
        if not scenes.is_floating_point():
            raise TypeError(f"scenes: {scenes.dtype}; linear light in floating point")
        count, frame = len(scenes), self.frame
        if place is None:
            places = [((frame.rows - rows) // 2, (frame.columns - columns) // 2)] * count
        else:
            asked = pairs("place", place)
            if any(at < 0 or at % 1 for both in asked for at in both):
                found = next(both for both in asked if any(at < 0 or at % 1 for at in both))
                raise ValueError(f"place: {found}; whole rows and columns from 0, within {frame.rows} and {frame.columns}")
            places = [(int(row), int(column)) for row, column in asked]
        shifts = None if shift is None else pairs("shift", shift)
        given = scenes if scenes.dtype == torch.float64 else scenes.float()
        return given, self._which(distance_mm, count), places, shifts

    def _stands(self, values: torch.Tensor) -> bool:
        """Whether numbers are a lens that makes pictures."""
        try:
            self._core.replanned(values.detach().cpu().numpy())
        except ValueError:
            return False
        return True

    def get_extra_state(self) -> dict[str, Any]:
        """What a checkpoint holds beside the numbers: their names, the lens they are put into, whose surfaces steps may have opened, and the lens that kernels
        are laid out for."""
        return {
            "names": self._all_names,
            "lens": self._core.base.to_toml(),
            "planned": self._planned_lens.to_toml(),
            "numbers": self._planned.tolist(),
            "passes": self._passes,
            "tuned": self._tuned,
        }

    def set_extra_state(self, state: dict[str, Any]) -> None:
        """Takes what `get_extra_state` gave. Raises ValueError where other numbers are trained, or the lens is another."""
        planned, base = (self._lens_of(state, name, self._core.base) for name in ("planned", "lens"))
        self._planned = torch.tensor(state["numbers"], dtype=torch.float64)
        self._tuned = state.get("tuned")
        if self._tuned:
            lens, numbers, settings = self._tuned
            self._core = self._core.based(Lens.from_toml(lens, "state_dict")).set_to(np.array(numbers), settings)
        self._core = self._core.based(planned).replanned(self._planned.numpy())
        self._planned_lens, self._passes = self._core.base, state["passes"]
        self._core = self._core.based(base)

    def extra_repr(self) -> str:
        """For ``print(layer)``."""
        trained: Iterable[str] = (f"{len(of)} {kind}" for kind, of in self.names.items())
        return f"{', '.join(trained)}; {len(self.distances_mm)} distances, frame {self.frame.columns} × {self.frame.rows}"
