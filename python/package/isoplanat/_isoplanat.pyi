from collections.abc import Callable, Mapping, Sequence
from inspect import Signature
from os import PathLike
from typing import Any, Final, Literal, TypeAlias, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

_Floats: TypeAlias = NDArray[np.float32] | NDArray[np.float64]
_File: TypeAlias = str | PathLike[str]
_Bounds: TypeAlias = float | tuple[float | None, float | None] | str
_DType: TypeAlias = Literal["float32", "float64"] | type[np.float32] | type[np.float64] | np.dtype[Any]

__all__ = [
    "STATUS",
    "Capture",
    "Frame",
    "Layer",
    "LayerRecord",
    "Lens",
    "Optimized",
    "Plan",
    "Psf",
    "Rays",
    "Record",
    "Render",
    "Steps",
    "__version__",
    "capture",
    "lenses",
    "make_dataset",
    "numbers_of",
    "psf_again",
    "read_picture",
    "render",
    "scene",
    "sensor_facts",
    "set_threads",
    "threads",
    "write_picture",
]
__version__: Final[str]
STATUS: Final[list[str]]
render: Final[Render]

def lenses() -> list[str]: ...
def numbers_of(lens: Lens, trainable: str | Sequence[str]) -> tuple[list[str], list[float]]: ...
def psf_again(first: Lens, keywords: dict[str, Any], lens: Lens | None, dtype: str) -> Psf: ...
def read_picture(file: _File) -> NDArray[np.float32]: ...
def scene(kind: str, rows: int, columns: int, *, seed: int = 1) -> NDArray[np.float32]: ...
def sensor_facts(sensor: _File) -> dict[str, Any]: ...
def set_threads(count: int) -> None: ...
def threads() -> int: ...
def write_picture(file: _File, picture: ArrayLike, *, float: bool = False, force: bool = False) -> None: ...
def capture(
    lens: Lens,
    photo: ArrayLike,
    frame: Frame | None = None,
    *,
    distance_mm: float | None = None,
    texels_per_pixel: float | None = None,
    illuminant: str | None = None,
    samples: int = 128,
    exposure: float = 1.0,
    glare: float = 0.0,
    noise: bool = True,
    seed: int = 1,
    sensor: _File | None = None,
) -> Capture: ...
def make_dataset(
    lenses: Lens | list[Lens] | dict[str, Lens],
    photos: _File,
    folder: _File,
    frame: Frame | tuple[int, int] | None,
    distances_mm: float | Sequence[float],
    crop: tuple[int, int] | None,
    crops: int,
    texels_per_pixel: float | None,
    noise: _File | None,
    noise_level: tuple[float, float] | Sequence[float],
    flat_field: bool,
    illuminant: str | None,
    min_psnr_db: float,
    diffraction: bool | str | None,
    judge: float,
    judge_samples: int,
    form: str,
    shard: int | None,
    index: int,
    of: int,
    seed: int,
    force: bool,
    progress: Callable[[float, str], object] | None,
) -> dict[str, Any]: ...
@final
class Frame:
    def __new__(
        cls, columns: int, rows: int, pitch_um: float, axis_px: tuple[float, float] | Sequence[float] | None = None
    ) -> Frame: ...
    @property
    def columns(self) -> int: ...
    @property
    def rows(self) -> int: ...
    @property
    def pitch_um(self) -> float: ...
    @property
    def axis_px(self) -> tuple[float, float]: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class Layer:
    def __new__(
        cls,
        lens: Lens,
        frame: Frame | None,
        distances_mm: float | Sequence[float] | None,
        trainable: str | Sequence[str],
        illuminant: str | None,
        settings: str | None = None,
        diffraction: bool | str | None = None,
    ) -> Layer: ...
    @property
    def names(self) -> list[str]: ...
    @property
    def values(self) -> list[float]: ...
    @property
    def distances_mm(self) -> list[float]: ...
    @property
    def reach_px(self) -> int: ...
    @property
    def frame(self) -> Frame: ...
    @property
    def base(self) -> Lens: ...
    def based(self, lens: Lens) -> Layer: ...
    def lens(self, values: NDArray[np.float64]) -> Lens: ...
    def replanned(self, values: NDArray[np.float64]) -> Layer: ...
    @property
    def settings(self) -> str: ...
    def set_to(self, values: NDArray[np.float64], settings: str) -> Layer: ...
    def tuned(
        self,
        values: NDArray[np.float64],
        scenes: ArrayLike,
        distances: Sequence[int],
        places: Sequence[tuple[int, int]],
        margin: int,
        shifts: Sequence[tuple[float, float]] | None = None,
    ) -> tuple[Layer, float, float, bool]: ...
    def record(
        self,
        values: NDArray[np.float64],
        scenes: ArrayLike,
        distances: Sequence[int],
        places: Sequence[tuple[int, int]],
        margin: int,
        shifts: Sequence[tuple[float, float]] | None = None,
        held: bool = True,
    ) -> tuple[_Floats, _Floats, _Floats, LayerRecord]: ...
    def __copy__(self) -> Layer: ...
    def __deepcopy__(self, _memo: Any) -> Layer: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class LayerRecord:
    @property
    def light(self) -> float: ...
    def vjp(
        self, captures_bar: ArrayLike, truths_bar: ArrayLike, illumination_bar: ArrayLike | None = None
    ) -> NDArray[np.float64]: ...

@final
class Steps:
    def __new__(
        cls,
        layer: Layer,
        values: NDArray[np.float64],
        hold: str | Sequence[str],
        constraints: dict[str, Any] | None,
        bounds: dict[str, Any] | None,
        frozen: Sequence[str],
    ) -> Steps: ...
    def step(
        self, layer: Layer, values: NDArray[np.float64], gradient: NDArray[np.float64], rate_mm: float
    ) -> tuple[Layer, NDArray[np.float64], float, float, float, list[str]] | None: ...
    def violation(self, layer: Layer, values: NDArray[np.float64]) -> float | None: ...
    @property
    def held(self) -> list[tuple[str, float, float]]: ...
    @property
    def memory(self) -> tuple[list[float], float, int, float]: ...
    def remember(self, first: Sequence[float], second: float, steps: int, reach: float) -> None: ...

@final
class Lens:
    def __new__(
        cls, file: _File, *, glasses: Sequence[_File] = ..., glass_for: Mapping[str, str] = ...
    ) -> Lens: ...
    @staticmethod
    def from_toml(text: str, name: str = "text") -> Lens: ...
    def to_toml(self) -> str: ...
    @property
    def name(self) -> str: ...
    @property
    def file(self) -> str: ...
    @property
    def notes(self) -> list[str]: ...
    @property
    def sha256(self) -> str: ...
    @property
    def wavelengths(self) -> list[tuple[float, float]]: ...
    @property
    def primary_nm(self) -> float: ...
    @property
    def distance_mm(self) -> float: ...
    @property
    def object_medium(self) -> str: ...
    @property
    def image_radius(self) -> float: ...
    @property
    def frame(self) -> Frame: ...
    @property
    def parameters(self) -> dict[str, float]: ...
    def replace(
        self, numbers: Mapping[str, float] | None = None, *, distance_mm: float | None = None, f_number: float | None = None
    ) -> Lens: ...
    def save(self, file: _File, *, force: bool = False) -> list[str]: ...
    def svg(self) -> str: ...
    def trace(
        self, origins: ArrayLike, directions: ArrayLike, *, wavelength_nm: float | None = None, clip: bool = False
    ) -> Rays: ...
    def trace_vjp(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        *,
        positions_bar: ArrayLike | None = None,
        directions_bar: ArrayLike | None = None,
        paths_bar: ArrayLike | None = None,
        wavelength_nm: float | None = None,
        clip: bool = False,
    ) -> tuple[dict[str, float], NDArray[np.float64], NDArray[np.float64]]: ...
    def psf(
        self,
        fields_deg: float | Sequence[float] | NDArray[np.float64] | None = None,
        distances_mm: float | Sequence[float] | NDArray[np.float64] | None = None,
        pitch_um: float | None = None,
        size: int | None = None,
        *,
        fields: int | None = None,
        wavelengths_nm: float | Sequence[float] | NDArray[np.float64] | None = None,
        rays: int | None = None,
        dtype: _DType | None = None,
        like: Psf | None = None,
        diffraction: bool | str | None = None,
    ) -> Psf: ...
    def psf_map(
        self,
        form: Literal["heights", "grid", "filters"],
        frame: Frame | None = None,
        *,
        distance_mm: float | None = None,
        heights: int | None = None,
        grid: tuple[int, int] | None = None,
        node_error: float | None = None,
        size: int | None = None,
        rays: int | None = None,
        sensor: _File | None = None,
        illuminant: str | None = None,
        diffraction: bool | str | None = None,
    ) -> dict[str, Any]: ...
    def inspect(self, *, wavelength_nm: float | None = None) -> dict[str, Any]: ...
    def spot(
        self,
        *,
        distance_mm: float | None = None,
        rays: int = 1600,
        fields_deg: float | Sequence[float] | NDArray[np.float64] | None = None,
        max_angle_deg: float | None = None,
    ) -> dict[str, Any]: ...
    def mtf(
        self,
        *,
        distance_mm: float | None = None,
        rays: int = 1600,
        fields_deg: float | Sequence[float] | NDArray[np.float64] | None = None,
        max_angle_deg: float | None = None,
        max_cycles_per_mm: float | None = None,
        shift_mm: float | None = None,
        cycles_per_mm: float | Sequence[float] | NDArray[np.float64] | None = None,
    ) -> dict[str, Any]: ...
    def distortion(self, *, distance_mm: float | None = None, max_angle_deg: float | None = None) -> dict[str, Any]: ...
    def report(
        self, file: _File | None = None, *, force: bool = False, distance_mm: float | None = None, rays: int = 1600
    ) -> dict[str, Any]: ...
    def optimize(
        self,
        *,
        vary: str | Sequence[str] = ...,
        fix: str | Sequence[str] = ...,
        bounds: Mapping[str, _Bounds] | None = None,
        constraints: Mapping[str, _Bounds] | None = None,
        targets: Mapping[str, tuple[float, float]] | None = None,
        quality: Literal["spot", "wavefront"] | None = None,
        distances_mm: float | Sequence[float] | None = None,
        iterations: int = 400,
        minutes: float | None = None,
    ) -> Optimized: ...
    def _repr_html_(self) -> str: ...
    def __eq__(self, other: object, /) -> bool: ...
    def __ne__(self, other: object, /) -> bool: ...
    def __hash__(self) -> int: ...
    def __copy__(self) -> Lens: ...
    def __deepcopy__(self, _memo: Any, /) -> Lens: ...
    def __reduce__(self) -> tuple[Any, ...]: ...

@final
class Rays:
    @property
    def positions(self) -> NDArray[np.float64]: ...
    @property
    def directions(self) -> NDArray[np.float64]: ...
    @property
    def paths(self) -> NDArray[np.float64]: ...
    @property
    def status(self) -> NDArray[np.uint8]: ...
    @property
    def surface(self) -> NDArray[np.int32]: ...

@final
class Psf:
    @property
    def kernels(self) -> _Floats: ...
    @property
    def outside(self) -> NDArray[np.float64]: ...
    @property
    def relative_illumination(self) -> NDArray[np.float64]: ...
    @property
    def centroid_um(self) -> NDArray[np.float64]: ...
    @property
    def radius_mm(self) -> NDArray[np.float64]: ...
    @property
    def angle_deg(self) -> NDArray[np.float64]: ...
    @property
    def slope(self) -> NDArray[np.float64]: ...
    @property
    def distances_mm(self) -> list[float]: ...
    @property
    def wavelengths_nm(self) -> list[float]: ...
    @property
    def weights(self) -> list[list[float]]: ...
    @property
    def pitch_um(self) -> float: ...
    def vjp(self, kernels_bar: ArrayLike) -> dict[str, float]: ...
    def __copy__(self) -> Psf: ...
    def __deepcopy__(self, _memo: Any) -> Psf: ...
    def __reduce__(self) -> tuple[Any, ...]: ...
    def energy(self) -> dict[str, NDArray[np.float64]] | None: ...

@final
class Plan:
    @property
    def predicted_psnr_db(self) -> float | None: ...
    @property
    def holds(self) -> bool: ...
    @property
    def frame(self) -> Frame: ...
    @property
    def distance_mm(self) -> float: ...
    @property
    def settings(self) -> dict[str, Any]: ...
    @property
    def kernel_size(self) -> int: ...
    @property
    def kernels(self) -> int: ...

@final
class Record:
    @property
    def truth(self) -> _Floats: ...
    @property
    def illumination(self) -> _Floats: ...
    @property
    def plan(self) -> Plan: ...
    def vjp(
        self, picture_bar: ArrayLike, truth_bar: ArrayLike | None = None, illumination_bar: ArrayLike | None = None
    ) -> dict[str, float]: ...

@final
class Render:
    @property
    def __signature__(self) -> Signature: ...
    def __call__(
        self,
        lens: Lens,
        photo: ArrayLike,
        frame: Frame | None = None,
        *,
        distance_mm: float | None = None,
        min_psnr_db: float | None = None,
        texels_per_pixel: float | None = None,
        diffraction: bool | str | None = None,
        illuminant: str | None = None,
        plan: Plan | None = None,
    ) -> tuple[_Floats, _Floats]: ...
    def plan(
        self,
        lens: Lens,
        photos: ArrayLike | list[NDArray[Any]],
        frame: Frame | None = None,
        *,
        distance_mm: float | None = None,
        min_psnr_db: float | None = None,
        texels_per_pixel: float | None = None,
        diffraction: bool | str | None = None,
        illuminant: str | None = None,
    ) -> Plan: ...
    def record(
        self,
        lens: Lens,
        photo: ArrayLike,
        frame: Frame | None = None,
        *,
        distance_mm: float | None = None,
        min_psnr_db: float | None = None,
        texels_per_pixel: float | None = None,
        diffraction: bool | str | None = None,
        illuminant: str | None = None,
        plan: Plan | None = None,
        region: tuple[int, int, int, int] | Sequence[int] | None = None,
    ) -> tuple[_Floats, Record]: ...
    def __reduce__(self) -> str: ...

@final
class Capture:
    @property
    def raw(self) -> NDArray[np.uint16]: ...
    @property
    def clean(self) -> NDArray[np.float32]: ...
    @property
    def cfa(self) -> str: ...
    @property
    def black_level(self) -> float: ...
    @property
    def white_level(self) -> float: ...
    @property
    def render_noise(self) -> float: ...
    @property
    def sensor_noise(self) -> float: ...
    @property
    def rays(self) -> int: ...
    def save(self, file: _File, *, force: bool = False) -> None: ...

@final
class Optimized:
    @property
    def lens(self) -> Lens: ...
    @property
    def rms_um(self) -> tuple[float, float]: ...
    @property
    def reason(self) -> str: ...
    @property
    def iterations(self) -> int: ...
    @property
    def violation(self) -> float: ...
    @property
    def moved(self) -> dict[str, tuple[float, float]]: ...
    @property
    def held(self) -> dict[str, tuple[float, float, float]]: ...
    @property
    def broken(self) -> list[str]: ...
