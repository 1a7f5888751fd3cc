"""What LibRaw makes of DNGs with repeated black tables, active areas and crops: the numbers of `raw_libraw.json`, which `crates/camera/src/raw/table.rs` reads.

    pip install rawpy==0.28.0 numpy
    python tests/peers/raw_libraw.py > tests/peers/raw_libraw.json

Files are synthetic: sample (r, c) of the stored picture is 4000 + (7919 r + 10473 c + 13 r c) mod 40000. LibRaw's bilinear picture keeps every
sample in its own colour; `pixels` are row and column in the active area (or the crop, where there is one) and that value. LibRaw divides by white
less the *smallest* black of the table; the specification (DNG 1.6, chapter 5) says the largest: values are LibRaw's times that quotient.
A crop is cut where LibRaw's `sizes` say that it stands.
"""

import json
import struct
import tempfile

import numpy as np
import rawpy

WHITE = 60000
ROWS, COLUMNS = 48, 64

# Rows and columns of the table, its levels, active area (top, left, bottom, right), crop (column, row, columns, rows).
CASES = [
    ("one level", (1, 1), [517], None, None),
    ("four levels", (2, 2), [500, 520, 540, 3000], None, None),
    ("a row of two", (1, 2), [400, 900], None, None),
    ("a column of two", (2, 1), [900, 400], None, None),
    ("four by four", (4, 4), [100 * k for k in range(1, 17)], None, None),
    ("three by five", (3, 5), [137 * k % 2000 for k in range(1, 16)], None, None),
    ("six by six within an active area", (6, 6), [331 * k % 1900 for k in range(36)], (4, 6, 44, 62), None),
    ("two by two within an active area", (2, 2), [200, 600, 1000, 1400], (6, 2, 46, 60), None),
    ("a crop", (1, 1), [256], None, (8, 6, 40, 36)),
    ("a crop of an active area", (4, 4), [90 * k for k in range(1, 17)], (2, 4, 46, 60), (6, 4, 44, 32)),
]


def samples():
    r, c = np.mgrid[0:ROWS, 0:COLUMNS]
    return (4000 + (7919 * r + 10473 * c + 13 * r * c) % 40000).astype("<u2")


def write(path, repeat, black, area, crop):
    pixels = samples().tobytes()
    shorts = lambda *v: (3, len(v), struct.pack(f"<{len(v)}H", *v))
    longs = lambda *v: (4, len(v), struct.pack(f"<{len(v)}I", *v))
    octets = lambda *v: (1, len(v), bytes(v))
    ratios = lambda *v: (10, len(v), b"".join(struct.pack("<2i", round(x * 10**6), 10**6) for x in v))
    plain = lambda *v: (5, len(v), b"".join(struct.pack("<2I", round(x * 10**6), 10**6) for x in v))
    text = lambda v: (2, len(v) + 1, v.encode() + b"\0")
    matrix = [3.240454, -1.537138, -0.498531, -0.969266, 1.876011, 0.041556, 0.055643, -0.204026, 1.057225]
    tags = {
        254: longs(0), 256: longs(COLUMNS), 257: longs(ROWS), 258: shorts(16), 259: shorts(1), 262: shorts(32803),
        271: text("Test"), 272: text("Table"), 273: longs(0), 274: shorts(1), 277: shorts(1), 278: longs(ROWS),
        279: longs(len(pixels)), 284: shorts(1), 33421: shorts(2, 2), 33422: octets(0, 1, 1, 2),
        50706: octets(1, 4, 0, 0), 50707: octets(1, 1, 0, 0), 50708: text("Test Table"), 50710: octets(0, 1, 2),
        50711: shorts(1), 50713: shorts(*repeat), 50714: longs(*black), 50717: longs(WHITE), 50721: ratios(*matrix),
        50728: plain(1, 1, 1), 50778: shorts(21),
    }
    if area:
        tags[50829] = longs(*area)
    if crop:
        tags[50719], tags[50720] = longs(*crop[:2]), longs(*crop[2:])
    start = 8 + 2 + 12 * len(tags) + 4
    place, beside, entries = start, b"", b""
    for tag in sorted(tags):
        kind, count, data = tags[tag]
        if tag == 273:
            entries += struct.pack("<HHI", tag, kind, count) + b"PIXL"
        elif len(data) <= 4:
            entries += struct.pack("<HHI", tag, kind, count) + data.ljust(4, b"\0")
        else:
            entries += struct.pack("<HHII", tag, kind, count, place)
            data += b"\0" * (len(data) % 2)
            beside, place = beside + data, place + len(data)
    entries = entries.replace(b"PIXL", struct.pack("<I", place))
    with open(path, "wb") as f:
        f.write(b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(tags)) + entries + b"\0" * 4 + beside + pixels)


def main():
    out = {"program": f"LibRaw {'.'.join(map(str, rawpy.libraw_version))}", "white": WHITE, "rows": ROWS, "columns": COLUMNS, "cases": []}
    for name, repeat, black, area, crop in CASES:
        with tempfile.NamedTemporaryFile(suffix=".dng") as f:
            write(f.name, repeat, black, area, crop)
            with rawpy.imread(f.name) as raw:
                picture = raw.postprocess(
                    demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR, gamma=(1, 1), no_auto_bright=True, output_bps=16, output_color=rawpy.ColorSpace.raw,
                    user_wb=[1, 1, 1, 1], adjust_maximum_thr=0, user_flip=0,
                )
                sizes = raw.sizes
        left, top, width, height = sizes.crop_left_margin, sizes.crop_top_margin, sizes.crop_width, sizes.crop_height
        if not crop:
            left, top, width, height = sizes.left_margin, sizes.top_margin, sizes.width, sizes.height
        # Margins count in the stored picture; the developed one starts at the active area.
        left, top = left - sizes.left_margin, top - sizes.top_margin
        scale = (WHITE - min(black)) / (WHITE - max(black)) / 65535
        pixels = []
        for k in range(24):
            i, j = 3 + (5 * k) % (height - 6), 3 + (7 * k) % (width - 6)
            colour = ((0, 1), (1, 2))[(top + i) % 2][(left + j) % 2]
            pixels.append([i, j, round(float(picture[top + i, left + j, colour]) * scale, 6)])
        out["cases"].append({
            "name": name, "repeat": repeat, "black": black, "area": area, "crop": crop, "size": [height, width], "pixels": pixels,
        })
    body = ",\n".join("  " + json.dumps(c) for c in out.pop("cases"))
    head = json.dumps(out)[:-1]
    print(f'{head}, "cases": [\n{body}\n]}}')


if __name__ == "__main__":
    main()
