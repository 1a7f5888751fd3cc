"""A lens as a function of JAX: pictures of patches of scenes, with the gradient of one's own loss by the lens's numbers, under ``jit`` and ``grad``.

Needs ``jax``, with ``jax.config.update("jax_enable_x64", True)``: the lens's numbers are float64. The optics run on the CPU, in callbacks that take and return NumPy
arrays alone. What backward needs is not kept: it renders the patches once more.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ._isoplanat import Frame, Layer, Lens
from ._placed import Placed, which

__all__ = ["LensFunction"]


class LensFunction(Placed):
    """``captures, truths, status = through(values, scenes, distance_mm, place)``.

    Parameters
    ----------
    lens : Lens
    frame : Frame, optional
        The lens's own raster where left out.
    distances_mm : float or sequence of float, optional
        Object distances that scenes may stand at; the lens's own where left out.
    trainable : str or sequence of str
        Names or patterns of the lens's numbers, such as "surface[*].curvature".
    illuminant : str, optional
        As of `isoplanat.render`.
    diffraction : "off", "approximate" or "on"
        Kernels of rays; of rays, convolved with the open pupil's diffraction; of scalar waves.
    held : bool
        Whether scenes stay where they were laid out, as differences and line searches ask for. They are placed before the lens as it is at every call otherwise, as
        ``isoplanat design`` places them; the gradient is that of scenes that stay.

    Attributes
    ----------
    names : list of str
        The numbers that move.
    values : array [n]
        What the lens has, float64: where to begin.
    error : str
        Why the last call that failed did so.
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
        held: bool = False,
    ) -> None:
        if not jax.config.read("jax_enable_x64"):  # type: ignore[no-untyped-call,unused-ignore]
            raise ValueError('jax_enable_x64: False; jax.config.update("jax_enable_x64", True): a lens\'s numbers are float64')
        self._core = Layer(lens, frame, distances_mm, trainable, illuminant, diffraction=diffraction)
        self.names = self._core.names
        self.values = jnp.asarray(self._core.values, dtype=jnp.float64)
        self.error, self.held = "", held
        self._through = functools.lru_cache(maxsize=None)(self._made)

    def lens(self, values: Any) -> Lens:
        """The lens with these numbers. Raises ValueError where they are no lens."""
        return self._core.lens(np.asarray(values, dtype=np.float64))

    def replanned(self, values: Any) -> "LensFunction":
        """The same with kernels laid out for the lens with these numbers: now and then, as numbers move. It is traced anew."""
        other = object.__new__(type(self))
        other._core = self._core.replanned(np.asarray(values, dtype=np.float64))
        other.names, other.values, other.error = self.names, jnp.asarray(values, dtype=jnp.float64), ""
        other.held = self.held
        other._through = functools.lru_cache(maxsize=None)(other._made)
        return other

    def check(self, status: Any) -> None:
        """Raises ValueError where a status says that a call failed; outside of ``jit``."""
        if np.any(np.asarray(status) != 0):
            raise ValueError(self.error or "a call failed")

    def __call__(
        self, values: Any, scenes: Any, distance_mm: Any = None, place: Any = None, *, margin: int = 0, shift: Any = None
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        """Captures and truths, both [B, 3, H - 2 margin, W - 2 margin], of the scenes' type, and a status: 0, or 1 where both are NaN (`check` says why).

        Parameters
        ----------
        values : array [n]
            The lens's numbers in the order of ``names``, float64.
        scenes : array [B, 3, H, W]
            Linear light, upright, float32 or float64; a texel is a pixel in the middle of the patch. They have no gradient here: one that is asked for
            raises TypeError.
        distance_mm : float or array [B], optional
            Each one of ``distances_mm``; the first where left out.
        place : array [B, 2] of int, optional
            Row and column of each patch's first pixel in the frame; the middle where left out.
        margin : int
            Texels on each side that only the blur sees.
        shift : array [B, 2], optional
            Texels down and across from each scene's middle to what its patch's middle sees; half a texel where left out, as of the layer of PyTorch.
        """
        values, scenes = jnp.asarray(values), jnp.asarray(scenes)
        if values.shape != (len(self.names),) or values.dtype != jnp.float64:
            raise ValueError(f"values: {values.dtype} of shape {values.shape}; float64 of [{len(self.names)}]")
        rows, columns = self._patch(scenes.shape, margin)
        if scenes.dtype not in (jnp.float32, jnp.float64):
            raise TypeError(f"scenes: {scenes.dtype}; linear light as float32 or float64")
        count, frame = scenes.shape[0], self.frame
        middle = ((frame.rows - rows) // 2, (frame.columns - columns) // 2)
        places = jnp.broadcast_to(jnp.asarray(middle if place is None else place), (count, 2))
        if not jnp.issubdtype(places.dtype, jnp.integer):
            raise TypeError(f"place: {places.dtype}; whole rows and columns")
        distances = jnp.broadcast_to(jnp.asarray(self.distances_mm[0] if distance_mm is None else distance_mm, jnp.float64), (count,))
        shifts = jnp.broadcast_to(jnp.asarray(0.0 if shift is None else shift, jnp.float64), (count, 2))
        found: tuple[jax.Array, jax.Array, jax.Array] = self._through(margin, shift is not None)(values, scenes, distances, places, shifts)
        return found

    def _recorded(self, how: tuple[int, bool], values: Any, scenes: Any, distances: Any, places: Any, shifts: Any) -> tuple[Any, ...]:
        margin, shifted = how
        depths = which(self.distances_mm, np.asarray(distances, dtype=np.float64).tolist())
        at = [(int(row), int(column)) for row, column in np.asarray(places)]
        if any(number < 0 for both in at for number in both):
            raise ValueError(f"place: {min(at)}; whole rows and columns from 0")
        by = [(float(down), float(across)) for down, across in np.asarray(shifts)] if shifted else None
        return self._core.record(np.asarray(values), np.ascontiguousarray(scenes), depths, at, margin, by, self.held)

    def _made(self, margin: int, shifted: bool) -> Callable[..., Any]:
        """The function for a margin, of scenes that are shifted or not, with its gradient."""
        how = (margin, shifted)

        def rendered(values: Any, scenes: Any, *rest: Any) -> tuple[Any, Any, Any]:
            shape = (*scenes.shape[:2], scenes.shape[2] - 2 * margin, scenes.shape[3] - 2 * margin)
            try:
                captures, truths, *_ = self._recorded(how, values, scenes, *rest)
            except ValueError as error:
                self.error = str(error)
                nothing = np.full(shape, np.nan, scenes.dtype)
                return nothing, nothing, np.int32(1)
            return captures, truths, np.int32(0)

        def pulled(values: Any, scenes: Any, distances: Any, places: Any, shifts: Any, captures_bar: Any, truths_bar: Any) -> Any:
            try:
                *_, record = self._recorded(how, values, scenes, distances, places, shifts)
                return record.vjp(np.ascontiguousarray(captures_bar), np.ascontiguousarray(truths_bar))
            except ValueError as error:
                self.error = str(error)
                return np.full(np.shape(values), np.nan)

        def primal(values: Any, scenes: Any, distances: Any, places: Any, shifts: Any) -> Any:
            shape = (*scenes.shape[:2], scenes.shape[2] - 2 * margin, scenes.shape[3] - 2 * margin)
            picture = jax.ShapeDtypeStruct(shape, scenes.dtype)  # type: ignore[no-untyped-call,unused-ignore]
            results = (picture, picture, jax.ShapeDtypeStruct((), jnp.int32))  # type: ignore[no-untyped-call,unused-ignore]
            return jax.pure_callback(rendered, results, values, scenes, distances, places, shifts, vmap_method="sequential")

        def forward(values: Any, scenes: Any, distances: Any, places: Any, shifts: Any) -> Any:
            if scenes.perturbed:
                raise TypeError("scenes: a gradient is asked for, and they have none here; jax.lax.stop_gradient(scenes)")
            given = tuple(argument.value for argument in (values, scenes, distances, places, shifts))
            return primal(*given), given

        def backward(given: Any, bars: Any) -> Any:
            scenes = given[1]
            nothing = jnp.zeros((*scenes.shape[:2], scenes.shape[2] - 2 * margin, scenes.shape[3] - 2 * margin), scenes.dtype)
            whole = [nothing if isinstance(b, jax.custom_derivatives.SymbolicZero) else b for b in bars[:2]]
            slopes = jax.ShapeDtypeStruct(given[0].shape, jnp.float64)  # type: ignore[no-untyped-call,unused-ignore]
            return jax.pure_callback(pulled, slopes, *given, *whole, vmap_method="sequential"), None, None, None, None

        through = jax.custom_vjp(primal)
        through.defvjp(forward, backward, symbolic_zeros=True)
        return through
