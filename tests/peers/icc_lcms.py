"""Primaries of sRGB and Display P3 as lcms2 builds them from chromaticities (Bradford, D50), to compare profiles with: `icc_lcms.json`.

    pip install pillow==13.0.0
    python tests/peers/icc_lcms.py [PICTURE …] > tests/peers/icc_lcms.json

With pictures it says what lcms2 sees of their embedded profiles instead.
"""

import ctypes
import glob
import io
import json
import os
import sys

import PIL
from PIL import Image, ImageCms


def seen(profile):
    p = profile.profile
    return {"red": p.red_colorant[0], "green": p.green_colorant[0], "blue": p.blue_colorant[0]}


def lcms():
    found = glob.glob(os.path.join(os.path.dirname(PIL.__file__), "..", "pillow.libs", "liblcms2*"))
    return ctypes.CDLL(found[0])


class Xyy(ctypes.Structure):
    _fields_ = [(n, ctypes.c_double) for n in ("x", "y", "Y")]


class Primaries(ctypes.Structure):
    _fields_ = [(n, Xyy) for n in ("red", "green", "blue")]


def made(library, primaries):
    library.cmsBuildGamma.restype = library.cmsCreateRGBProfile.restype = ctypes.c_void_p
    library.cmsBuildGamma.argtypes = [ctypes.c_void_p, ctypes.c_double]
    library.cmsCreateRGBProfile.argtypes = [ctypes.POINTER(Xyy), ctypes.POINTER(Primaries), ctypes.POINTER(ctypes.c_void_p)]
    library.cmsSaveProfileToMem.argtypes = [ctypes.c_void_p, ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint32)]
    curve = library.cmsBuildGamma(None, 1.0)
    curves = (ctypes.c_void_p * 3)(curve, curve, curve)
    white = Xyy(0.3127, 0.3290, 1.0)
    handle = library.cmsCreateRGBProfile(ctypes.byref(white), ctypes.byref(Primaries(*[Xyy(x, y, 1.0) for x, y in primaries])), curves)
    size = ctypes.c_uint32(0)
    library.cmsSaveProfileToMem(handle, None, ctypes.byref(size))
    buffer = ctypes.create_string_buffer(size.value)
    library.cmsSaveProfileToMem(handle, buffer, ctypes.byref(size))
    return ImageCms.ImageCmsProfile(io.BytesIO(buffer.raw))


def main():
    if len(sys.argv) > 1:
        for path in sys.argv[1:]:
            profile = Image.open(path).info.get("icc_profile")
            print(path, "no profile" if profile is None else json.dumps(seen(ImageCms.ImageCmsProfile(io.BytesIO(profile)))))
        return
    library = lcms()
    spaces = {
        "srgb": [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06)],
        "display-p3": [(0.680, 0.320), (0.265, 0.690), (0.150, 0.060)],
    }
    out = {"program": f"lcms2 {ImageCms.core.littlecms_version}"}
    for name, primaries in spaces.items():
        out[name] = {k: [round(v, 6) for v in values] for k, values in seen(made(library, primaries)).items()}
    print(json.dumps(out, indent=1))


if __name__ == "__main__":
    main()
