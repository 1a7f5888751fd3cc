//! A row's pixels: means and variances from the sums over their rays.

use super::GROUPS;
use super::draw::{Met, Texels};
use super::stream::{Pixel, Sink, Stream, View, Waiting};

/// What one row counted.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) rays: u64,
    pub(super) passed: u64,
    pub(super) outside: u64,
}

/// Sums of a pixel: its groups, then the ray outside the ellipse.
const SUMS: usize = GROUPS + 1;

/// The pixels of a row on their way.
pub(super) struct Row<'a> {
    view: View<'a>,
    stream: Stream<'a>,
    sums: PixelSums<'a>,
}

/// Sums over rays of `n'² L cos⁴θ′ / Z² A`.
struct PixelSums<'a> {
    view: View<'a>,
    texels: &'a Texels<'a>,
    met: Box<Met>,
    /// [`SUMS`] of every pixel, in the order of [`Row::add`].
    sums: Vec<f64>,
    channels: Vec<usize>,
    passed: u64,
    outside: u64,
}

impl<'a> Row<'a> {
    pub(super) fn new(view: View<'a>, texels: &'a Texels<'a>) -> Self {
        let met = Box::new(Met::new());
        let sums = PixelSums { view, texels, met, sums: Vec::new(), channels: Vec::new(), passed: 0, outside: 0 };
        Self { view, stream: Stream::new(view), sums }
    }

    /// Draws the rays of the next pixel.
    pub(super) fn add(&mut self, pixel: Pixel) {
        self.sums.sums.resize(self.sums.sums.len() + SUMS, 0.0);
        self.sums.channels.push(pixel.channel);
        self.stream.add(pixel, &mut self.sums);
    }

    /// Mean and variance of the mean of every pixel, in the order in which they were added.
    pub(super) fn finish(&mut self) -> impl Iterator<Item = (f64, f64)> {
        self.stream.finish(&mut self.sums);
        let (size, n) = (self.view.group_size() as f64, GROUPS as f64);
        let axis = self.view.rear.axis_irradiance;
        self.sums.sums.chunks_exact(SUMS).zip(&self.sums.channels).map(move |(sums, channel)| {
            let groups = sums[..GROUPS].iter().map(|sum| sum / size);
            let (sum, squares) = groups.fold((0.0, 0.0), |(sum, squares), g| (sum + g, squares + g * g));
            let mean = sum / n;
            let variance = ((squares - n * mean * mean) / (n * (n - 1.0))).max(0.0);
            // A single draw: its square is no less than its variance in the mean.
            let found = sums[GROUPS];
            let scale = axis[*channel].recip();
            ((mean + found) * scale, (variance + found * found) * scale * scale)
        })
    }

    /// The counts so far.
    pub(super) fn tally(&self) -> Tally {
        Tally { rays: self.stream.rays, passed: self.sums.passed, outside: self.sums.outside }
    }
}

impl Sink for PixelSums<'_> {
    fn take(&mut self, traced: &Waiting) {
        self.texels.meet(&traced.tile.rays, &mut self.met);
        for span in &traced.spans {
            let (mut sum, mut passed) = (0.0, 0);
            for lane in span.first..span.end {
                if traced.passed(self.view.rear, lane) {
                    passed += 1;
                    sum += traced.draw.weight[lane] * self.texels.radiance(span.channel, &self.met, lane);
                }
            }
            self.sums[span.number * SUMS + span.sum] += sum;
            self.passed += passed;
            self.outside += if span.sum == GROUPS { passed } else { 0 };
        }
    }
}
