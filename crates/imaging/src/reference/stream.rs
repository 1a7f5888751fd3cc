//! The rays of one pixel after the other, traced tile by tile.
//!
//! A pixel's stream of random numbers depends on its place alone, a ray's numbers on that ray alone, and a pixel's rays
//! come in the order in which they were drawn: what is made of them depends neither on threads nor on the region.

use glam::DVec2;

use super::bounds::Footprints;
use super::draw::{Draw, Draws};
use super::rear::RearView;
use super::sampler::Group;
use super::{GROUPS, Settings};
use crate::frame::Frame;
use crate::sensor::noise::mixed;
use isoplanat_optics::trace::lanes::{TILE, Tile};

/// What rays are drawn from.
#[derive(Clone, Copy)]
pub(super) struct View<'a> {
    pub(super) frame: &'a Frame,
    pub(super) rear: &'a RearView,
    pub(super) footprints: Option<&'a Footprints>,
    pub(super) settings: Settings,
}

impl View<'_> {
    /// Rays of one group.
    pub(super) fn group_size(&self) -> usize {
        self.settings.samples.div_ceil(GROUPS)
    }
}

/// One pixel and channel.
#[derive(Clone, Copy)]
pub(super) struct Pixel {
    pub(super) row: isize,
    pub(super) col: isize,
    pub(super) channel: usize,
}

impl Pixel {
    /// The stream of the pixel's random numbers.
    fn stream(self, seed: u64) -> fastrand::Rng {
        let seed = mixed(mixed(mixed(seed, self.row as u64), self.col as u64), self.channel as u64);
        fastrand::Rng::with_seed(seed)
    }

    /// Whether any of its rays has an ellipse to go through.
    fn sees_light(self, view: View<'_>) -> bool {
        let Some(footprints) = view.footprints else { return true };
        let [x, y] = view.frame.sensor_mm_from_pixel([self.col as f64 + 0.5, self.row as f64 + 0.5]);
        let (middle, half) = (x * x + y * y, 0.75 * view.frame.pitch_mm);
        let middle = middle.sqrt();
        !footprints.is_empty_between([(middle - half).max(0.0), middle + half])
    }
}

/// Neighbouring lanes that add to one sum of a pixel: one of its groups, or ([`GROUPS`]) the ray outside the ellipse.
#[derive(Clone, Copy)]
pub(super) struct Span {
    /// The number that the pixel was added with.
    pub(super) number: usize,
    pub(super) sum: usize,
    pub(super) channel: usize,
    pub(super) first: usize,
    pub(super) end: usize,
}

/// What is made of traced rays.
pub(super) trait Sink {
    /// Sees the lanes below `traced.count`, in the order in which they were drawn.
    fn take(&mut self, traced: &Waiting);
}

/// Rays that wait for their tile to fill.
pub(super) struct Waiting {
    pub(super) tile: Tile,
    pub(super) draw: Box<Draw>,
    pub(super) count: usize,
    pub(super) spans: Vec<Span>,
}

impl Waiting {
    fn new() -> Self {
        Self { tile: Tile::new(), draw: Box::new(Draw::new()), count: 0, spans: Vec::with_capacity(TILE) }
    }

    /// Adds points `from..` of a block of a group: as many as fit of `most`, whose number is returned.
    #[inline]
    fn fill(&mut self, rear: &RearView, pixel: Pixel, block: &Group, from: usize, most: usize) -> usize {
        let lanes = self.count..TILE.min(self.count + most.min(TILE - from));
        // The pupil gets the first two dimensions: its edge makes most of the noise.
        for (d, bits) in self.draw.bits.iter_mut().enumerate() {
            block.bits(d, from, &mut bits[lanes.clone()]);
        }
        self.draw.corner[0][lanes.clone()].fill(pixel.col as f64);
        self.draw.corner[1][lanes.clone()].fill(pixel.row as f64);
        let colour = &mut self.tile.colour[lanes.clone()];
        block.bits(self.draw.bits.len(), from, colour);
        rear.colours(pixel.channel, colour, &mut self.draw.index_square[lanes.clone()]);
        self.count = lanes.end;
        lanes.len()
    }

    /// Keeps the rays outside their ellipses; each has a span of its own.
    fn keep_outside(&mut self, footprints: &Footprints) {
        let mut kept = 0;
        for lane in 0..self.count {
            let target = DVec2::new(self.draw.target[0][lane], self.draw.target[1][lane]);
            if footprints.at(self.draw.radius[lane]).contains(target) {
                continue;
            }
            self.tile.rays.set(kept, self.tile.rays.ray(lane));
            self.tile.colour[kept] = self.tile.colour[lane];
            self.draw.move_lane(kept, lane);
            self.spans[kept] = Span { first: kept, end: kept + 1, ..self.spans[lane] };
            kept += 1;
        }
        self.spans.truncate(kept);
        self.count = kept;
    }

    /// Whether the ray of `lane` met the scene.
    #[inline]
    pub(super) fn passed(&self, rear: &RearView, lane: usize) -> bool {
        rear.passed(&self.tile, lane) && self.draw.weight[lane] > 0.0
    }
}

/// Rays on their way to a sink.
pub(super) struct Stream<'a> {
    view: View<'a>,
    inside: Waiting,
    outside: Waiting,
    draws: Draws<'a>,
    whole: Draws<'a>,
    pixels: usize,
    /// Rays started.
    pub(super) rays: u64,
}

impl<'a> Stream<'a> {
    pub(super) fn new(view: View<'a>) -> Self {
        Self {
            view,
            inside: Waiting::new(),
            outside: Waiting::new(),
            draws: Draws::new(view.frame, view.rear, view.footprints),
            whole: Draws::new(view.frame, view.rear, None),
            pixels: 0,
            rays: 0,
        }
    }

    /// Draws the rays of the next pixel; pixels are numbered from 0.
    pub(super) fn add(&mut self, pixel: Pixel, sink: &mut impl Sink) {
        let mut rng = pixel.stream(self.view.settings.seed);
        let groups: [Group; GROUPS] = std::array::from_fn(|_| Group::new(&mut rng));
        let size = self.view.group_size();
        if pixel.sees_light(self.view) {
            for (sum, group) in groups.iter().enumerate() {
                for start in (0..size).step_by(TILE) {
                    self.draw(pixel, &group.block(start / TILE), (size - start).min(TILE), sum, sink);
                }
            }
        }
        if self.view.footprints.is_some() {
            // One ray through the part of the rear aperture outside the ellipse.
            self.draw(pixel, &Group::new(&mut rng), 1, GROUPS, sink);
        }
        self.pixels += 1;
    }

    /// The first `most` points of `block`, for `sum`.
    #[inline]
    fn draw(&mut self, pixel: Pixel, block: &Group, most: usize, sum: usize, sink: &mut impl Sink) {
        let mut from = 0;
        while from < most {
            let waiting = if sum < GROUPS { &mut self.inside } else { &mut self.outside };
            let first = waiting.count;
            from += waiting.fill(self.view.rear, pixel, block, from, most - from);
            let (number, channel, end) = (self.pixels, pixel.channel, waiting.count);
            waiting.spans.push(Span { number, sum, channel, first, end });
            if end == TILE {
                if sum < GROUPS { self.trace_inside(sink) } else { self.trace_outside(sink) }
            }
        }
    }

    /// Traces what waits.
    pub(super) fn finish(&mut self, sink: &mut impl Sink) {
        self.trace_inside(sink);
        self.trace_outside(sink);
    }

    fn trace_inside(&mut self, sink: &mut impl Sink) {
        self.inside.draw.place(&self.draws, &mut self.inside.tile.rays);
        self.rays += trace(self.view.rear, &mut self.inside, sink);
    }

    /// The same for rays through the whole aperture, without those within the ellipse.
    fn trace_outside(&mut self, sink: &mut impl Sink) {
        let Some(footprints) = self.view.footprints else { return };
        self.outside.draw.place(&self.whole, &mut self.outside.tile.rays);
        self.outside.keep_outside(footprints);
        self.rays += trace(self.view.rear, &mut self.outside, sink);
    }
}

/// Traces the rays of `waiting`, hands them over and forgets them; how many there were.
fn trace(rear: &RearView, waiting: &mut Waiting, sink: &mut impl Sink) -> u64 {
    let count = waiting.count;
    waiting.tile.resize(count);
    rear.program.trace_tile(&mut waiting.tile);
    sink.take(waiting);
    waiting.spans.clear();
    waiting.count = 0;
    count as u64
}
