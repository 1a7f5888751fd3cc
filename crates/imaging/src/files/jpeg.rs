//! Whether a JPEG has its end: decoders show what is missing as grey, and say nothing.

use std::io::{BufRead, ErrorKind, Read, Result, copy, sink};

/// Whether the segments of a JPEG (ITU-T T.81, annex B) run to an end-of-image marker. What stands behind it is not looked at.
pub(super) fn has_end(from: &mut impl BufRead) -> Result<bool> {
    match end(from) {
        Err(e) if e.kind() == ErrorKind::UnexpectedEof => Ok(false),
        other => other,
    }
}

fn end(from: &mut impl BufRead) -> Result<bool> {
    let byte = |from: &mut dyn BufRead| {
        let mut one = [0];
        from.read_exact(&mut one).map(|()| one[0])
    };
    loop {
        // Between markers stand the samples of a scan; in them 0xff is followed by 0.
        if from.skip_until(0xff)? == 0 {
            return Ok(false);
        }
        let mut marker = 0xff;
        while marker == 0xff {
            marker = byte(from)?;
        }
        match marker {
            0xd9 => return Ok(true),
            // Stuffing, markers without a length: restart, start of image, temporary.
            0x00 | 0x01 | 0xd0..=0xd8 => {}
            _ => {
                let length = u64::from(byte(from)?) << 8 | u64::from(byte(from)?);
                let rest = length.saturating_sub(2);
                if copy(&mut from.by_ref().take(rest), &mut sink())? < rest {
                    return Ok(false);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::codecs::jpeg::JpegEncoder;

    /// Cut anywhere, a picture has no end; with bytes behind it, it has.
    #[test]
    fn a_cut_picture_has_no_end() {
        let picture =
            image::RgbImage::from_fn(40, 30, |x, y| image::Rgb([(x * 6) as u8, (y * 8) as u8, (x * y) as u8]));
        let mut whole = Vec::new();
        picture.write_with_encoder(JpegEncoder::new_with_quality(&mut whole, 95)).expect("in memory");
        let ends = |bytes: &[u8]| has_end(&mut &bytes[..]).expect("in memory");
        assert!(whole.len() > 1000 && ends(&whole));
        for cut in 0..whole.len() {
            assert!(!ends(&whole[..cut]), "{cut} of {}", whole.len());
        }
        whole.extend([0xff, 0xd8, 1, 2, 3]);
        assert!(ends(&whole));
        assert!(!ends(&[0xff; 1000]) && !ends(&[0; 1000]));
    }
}
