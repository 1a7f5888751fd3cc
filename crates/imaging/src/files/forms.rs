//! Forms of files that readers of others take in several ways, and files that ask for more than there is.

use std::path::Path;

use ndarray::Array3;
use tiff::encoder::colortype;

use super::*;
use isoplanat_base::math::memory::{GIB, Limit};

/// A TIFF, tag by tag, little-endian (TIFF 6.0, section 2): one strip, entries of 16 or 32 bits.
fn tiff_file(path: &Path, entries: &[(u16, u32)], bits: &[u16], strip: &[u8]) {
    let mut all: Vec<(u16, u16, u32, u32)> = entries.iter().map(|(tag, v)| (*tag, 3, 1, *v)).collect();
    let count = all.len() as u32 + 3;
    let beside = 8 + 2 + 12 * count + 4;
    let place = if bits.len() > 2 { beside } else { bits.iter().rev().fold(0, |sum, b| sum << 16 | u32::from(*b)) };
    all.push((258, 3, bits.len() as u32, place));
    all.push((273, 4, 1, beside + 2 * bits.len() as u32));
    all.push((279, 4, 1, strip.len() as u32));
    all.sort_unstable();
    let mut file = b"II*\0\x08\0\0\0".to_vec();
    file.extend((all.len() as u16).to_le_bytes());
    for (tag, kind, count, value) in all {
        file.extend([tag.to_le_bytes(), kind.to_le_bytes()].concat());
        file.extend([count.to_le_bytes(), value.to_le_bytes()].concat());
    }
    file.extend([0; 4]);
    bits.iter().for_each(|b| file.extend(b.to_le_bytes()));
    file.extend(strip);
    std::fs::write(path, file).expect("writes");
}

/// Refused by what the header says: there are no pixels that could be decoded.
#[test]
fn pictures_beyond_the_memory_are_refused_before_they_are_decoded() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.tif");
    let memory = |gib: u64| Limit { bytes: gib * GIB };
    for (compression, name) in [(8, "deflate"), (5, "LZW"), (1, "none"), (32773, "PackBits"), (7, "JPEG")] {
        let entries = [(256, 14_000), (257, 14_000), (259, compression), (262, 1), (277, 1), (278, 14_000)];
        tiff_file(&path, &entries, &[8], &[0x55; 4000]);
        let error = read_stored_within(&path, None, memory(2)).expect_err("too large");
        let text = error.to_string();
        assert!(text.starts_with("memory: ") && text.contains("a.tif: 14000 × 14000 pixels"), "{name}: {text}");
        // Where there is room, it is read, and found to be none.
        let error = read_stored_within(&path, None, memory(64)).expect_err("no pixels").to_string();
        assert!(!error.starts_with("memory: ") && error.contains("a.tif"), "{name}: {error}");
    }
    // What a picture takes is not refused: samples twice and three planes.
    let image = Array3::from_elem((3, 64, 64), 0.5);
    for (name, bytes) in [("b.tif", 12), ("b.png", 12), ("b.jpg", 6), ("b.npy", 24)] {
        let path = folder.path().join(name);
        write_picture(&path, &image, Encoding::Srgb).expect("writes");
        let enough = 64 * 64 * (bytes + 12) + 4096;
        assert!(read_stored_within(&path, None, Limit { bytes: enough }).is_ok(), "{name}");
        let error = read_seen_within(&path, Limit { bytes: enough / 2 }).expect_err("too little").to_string();
        assert!(error.starts_with("memory: ") && error.contains(name), "{error}");
    }
}

/// What alpha hides is told; where it hides nothing, nothing is lost.
#[test]
fn alpha_that_is_not_opaque_is_told() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let left_out = |name: &str| {
        let stored = read_stored(&at(name), None).expect("reads");
        let planes = read_planes(&at(name), None).expect("reads");
        assert_eq!(stored.left_out, planes.left_out, "{name}");
        stored.left_out.unwrap_or_default()
    };
    for alpha in [255u8, 128] {
        let told = |name: &str, word: &str| {
            let words = left_out(name);
            assert_eq!(
                (words.contains(word), words.is_empty()),
                (alpha < 255, alpha == 255),
                "{name} {alpha}: {words}"
            );
        };
        for (kind, word) in [(1, "multiplied by alpha"), (2, "is left out")] {
            let size = [(256, 2), (257, 1), (259, 1), (278, 1), (338, kind)];
            let entries = [&size[..], &[(262, 2), (277, 4)]].concat();
            tiff_file(&at("rgba.tif"), &entries, &[8; 4], &[90, 80, 70, 255, 60, 50, 40, alpha]);
            told("rgba.tif", word);
            let entries = [&size[..], &[(262, 1), (277, 2)]].concat();
            tiff_file(&at("greya.tif"), &entries, &[8; 2], &[90, 255, 60, alpha]);
            told("greya.tif", word);
        }
        let deep = u16::from(alpha) * 257;
        let rgba = image::RgbaImage::from_raw(2, 1, vec![90, 80, 70, 255, 60, 50, 40, alpha]).expect("two pixels");
        rgba.save(at("rgba.png")).expect("writes");
        told("rgba.png", "is left out");
        let grey = ImageBuffer::<image::LumaA<u16>, Vec<u16>>::from_raw(2, 1, vec![900, 65535, 600, deep]);
        grey.expect("two pixels").save(at("greya.png")).expect("writes");
        told("greya.png", "is left out");
        let array = ndarray::Array3::from_shape_vec((1, 2, 4), vec![90u8, 80, 70, 255, 60, 50, 40, alpha]);
        ndarray_npy::write_npy(at("rgba.npy"), &array.expect("two pixels")).expect("writes");
        told("rgba.npy", "is left out");
    }
    // A palette whose colours have one.
    let mut info = png::Info::with_size(2, 1);
    (info.color_type, info.bit_depth) = (png::ColorType::Indexed, png::BitDepth::Eight);
    (info.palette, info.trns) = (Some(vec![90; 6].into()), Some(vec![255, 7].into()));
    let file = std::fs::File::create(at("trns.png")).expect("a file");
    let mut writer = png::Encoder::with_info(file, info).expect("a form").write_header().expect("writes");
    writer.write_image_data(&[0, 1]).expect("writes");
    drop(writer);
    assert!(left_out("trns.png").contains("is left out"));
}

/// TIFF 6.0, section 14: differences of pixels belong to LZW, and since to deflate. Readers take others in two ways.
#[test]
fn differences_that_are_not_compressed_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("a.tif");
    for (predictor, compression) in [(1, 1), (2, 1), (3, 1), (2, 32773)] {
        let entries = [(256, 2), (257, 1), (259, compression), (262, 1), (277, 1), (278, 1), (317, predictor)];
        tiff_file(&path, &entries, &[8], &[90, 7]);
        let read = read_linear(&path);
        if predictor == 1 {
            assert_eq!(read.expect("no differences").dim(), (3, 1, 2));
            continue;
        }
        let error = read.expect_err("ambiguous").to_string();
        assert!(error.contains("a.tif") && error.contains(&format!("Predictor {predictor}")), "{error}");
    }
    for compression in [tiff::encoder::Compression::Lzw, tiff::encoder::Compression::Deflate(Default::default())] {
        let file = std::io::BufWriter::new(std::fs::File::create(&path).expect("a file"));
        let writer = TiffEncoder::new(file).expect("writes").with_compression(compression);
        let mut writer = writer.with_predictor(tiff::encoder::Predictor::Horizontal);
        writer.write_image::<colortype::Gray8>(2, 1, &[90, 97]).expect("writes");
        drop(writer);
        let planes = read_planes(&path, Some(Encoding::Linear)).expect("reads");
        assert_eq!(planes.values.iter().map(|v| (v * 255.0).round()).collect::<Vec<_>>(), [90.0, 97.0]);
    }
}

/// A decoder's words about damaged bytes are no failure of the system's: what is allowed stands beside them.
#[test]
fn damaged_pictures_say_what_is_allowed() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    let entries = [(256, 40), (257, 40), (259, 5), (262, 1), (277, 1), (278, 40)];
    tiff_file(&at("lzw.tif"), &entries, &[8], &[0xff; 900]);
    // The range of `cICP` is 0 or 1.
    let info = png::Info::with_size(1, 1);
    let file = std::fs::File::create(at("cicp.png")).expect("a file");
    let mut writer = png::Encoder::with_info(file, info).expect("a form").write_header().expect("writes");
    writer.write_chunk(png::chunk::ChunkType(*b"cICP"), &[255, 255, 9, 1]).expect("writes");
    writer.write_image_data(&[9]).expect("writes");
    drop(writer);
    for name in ["lzw.tif", "cicp.png"] {
        let Err(error) = read_linear(&at(name)) else { panic!("{name}: damaged") };
        let text = error.to_string();
        assert!(text.contains(name) && !text.contains("reading") && text.contains("a PNG, JPEG or TIFF"), "{text}");
    }
}
