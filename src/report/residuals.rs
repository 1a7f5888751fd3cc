//! Residuals of a calibration over the frame: every corner where it is seen, and how far from where the model lands it.

use super::svg::{Anchor, HUES, Svg};
use super::table::significant;

/// Width of the frame in the drawing, px; margins beside it; room for the legend.
const WIDTH: f64 = 720.0;
const MARGIN: f64 = 14.0;
const FOOT: f64 = 34.0;
/// Length that the root mean square residual is drawn with, px.
const TYPICAL: f64 = 14.0;

/// One corner, pixels of its picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Number of its picture.
    pub picture: usize,
    /// Where it is seen.
    pub at: [f64; 2],
    /// Seen less landed.
    pub off: [f64; 2],
}

/// What is drawn.
#[derive(Clone, Debug, PartialEq)]
pub struct Residuals {
    /// Columns and rows.
    pub size: [usize; 2],
    /// Centre of distortion.
    pub centre: [f64; 2],
    /// The corners.
    pub seen: Vec<Seen>,
    /// Root mean square residual, pixels.
    pub rms: f64,
}

impl Residuals {
    /// The drawing: a dot where a corner is seen, a line to where it is off, enlarged; a hue a picture.
    pub fn svg(&self) -> String {
        let [columns, rows] = self.size.map(|n| n.max(1) as f64);
        let scale = WIDTH / columns;
        let height = rows * scale;
        let place = |[x, y]: [f64; 2]| [MARGIN + scale * x, MARGIN + scale * y];
        let enlarged = if self.rms > 0.0 { TYPICAL / (scale * self.rms) } else { 1.0 };
        let mut svg = Svg::new(WIDTH + 2.0 * MARGIN, height + 2.0 * MARGIN + FOOT);
        let frame = [[0.0, 0.0], [columns, 0.0], [columns, rows], [0.0, rows]].map(place);
        svg.polygon(&frame, "fill=\"none\" stroke=\"currentColor\" stroke-opacity=\"0.5\"");
        let centre = place(self.centre);
        for [x, y] in [[7.0, 0.0], [0.0, 7.0]] {
            svg.line([centre[0] - x, centre[1] - y], [centre[0] + x, centre[1] + y], "stroke=\"currentColor\"");
        }
        for seen in &self.seen {
            let hue = HUES[seen.picture % HUES.len()];
            let end = [0, 1].map(|k| seen.at[k] + enlarged * seen.off[k]);
            svg.line(place(seen.at), place(end), &format!("stroke=\"{hue}\" stroke-width=\"1.2\""));
            svg.dot(place(seen.at), 1.6, hue);
        }
        let foot = height + 2.0 * MARGIN + 0.6 * FOOT;
        svg.line([MARGIN, foot - 4.0], [MARGIN + TYPICAL, foot - 4.0], "stroke=\"currentColor\" stroke-width=\"1.6\"");
        let rms = significant(self.rms, 3);
        let text = format!(
            "{rms} px: seen less landed, {} × enlarged; {} corners, rms {rms} px; + centre of distortion",
            significant(enlarged, 2),
            self.seen.len()
        );
        svg.text([MARGIN + TYPICAL + 8.0, foot], Anchor::Start, 13.0, &text);
        svg.finish("Corners of the chessboard, and how far they are from where the model lands them")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_corner_is_drawn_at_its_place() {
        let seen = Seen { picture: 11, at: [50.0, 25.0], off: [0.5, 0.0] };
        let drawn = Residuals { size: [100, 50], centre: [50.0, 25.0], seen: vec![seen], rms: 0.5 };
        let text = drawn.svg();
        // The middle of the frame, and a line of the typical length to the right.
        assert!(text.contains("cx=\"374.00\" cy=\"194.00\""), "{text}");
        assert!(text.contains("x2=\"388.00\" y2=\"194.00\""), "{text}");
        assert!(text.contains("1 corners, rms 0.5 px"), "{text}");
        assert!(Residuals { rms: 0.0, seen: Vec::new(), ..drawn }.svg().contains("0 corners"));
    }
}
