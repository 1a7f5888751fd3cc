//! The ladders of given scenes, and the cheapest settings that hold what is asked for.

use std::cell::RefCell;
use std::collections::HashMap;

use ndarray::Axis;

use super::bending::{Bent, MANY};
use super::choose::{Choice, Ladders, Measuring, cheapest};
use super::cost::{Work, convolution, seconds};
use super::draft::{Draft, FINE_WAVELENGTHS};
use super::needs::Channels;
use super::nodes::Nodes;
use super::plan::{DepthPlan, RenderPlan, Settings, in_cells, quadrature};
use super::probe::{Probing, Values};
use super::renderer::Renderer;
use super::shared::Shared;
use super::source::WarpedScene;
use super::stands::{SIDE, Stand};
use crate::plane::Region;
use crate::render::node_grid::NodeGrid;
use isoplanat_base::error::Result;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::Optics;

/// Dense points of the kernels that probes and nodes are looked at with.
const DENSE: usize = 600;
/// Probes at most where kernels go by diffraction and paths differ by many wavelengths. Elsewhere as many as of rays: a third of them took one sample a pixel of a
/// photograph to be enough that was not.
const BENT: usize = 10;
/// Kernel sizes from which fine rasters are 2 and not 4 samples a pixel and probes half as many, and from which they are
/// few: what is blurred differs less from place to place.
const WIDE: (usize, usize) = (65, 201);
/// Kernel sizes up to which the finest raster has 8 samples a pixel.
const SHARP: usize = 33;

/// Most scene samples a pixel that are tried, and probes, for kernels of `size` cells of `bin` pixels.
fn efforts(size: usize, bin: usize) -> (usize, usize) {
    let probes = match size {
        _ if size > WIDE.1 => 8,
        _ if size > WIDE.0 => 16,
        _ if size > SHARP => 32,
        _ => 96,
    };
    let samples = match size {
        _ if bin > 1 => 1,
        _ if size <= SHARP => 8,
        _ if size <= WIDE.0 => 4,
        _ => 2,
    };
    (samples, probes)
}

impl Draft<'_> {
    /// Ladders on probes of the scenes over `region`, and the cheapest settings whose mean square error is at most `target`; with diffraction where `bent` says so.
    ///
    /// # Errors
    /// As [`Optics::compute`].
    pub(super) fn measure(
        &self,
        lens: &Lens,
        region: Region,
        target: f64,
        bent: Option<&Bent>,
    ) -> Result<(Choice, Ladders)> {
        let (first, channels) = (&self.first, &self.needs.channels);
        // What rays tell is looked at in their own windows.
        let halves =
            |widths: &[usize]| -> Vec<usize> { widths.iter().map(|half| in_cells(*half, first.bin)).collect() };
        let size = 2 * halves(&self.of_rays)[Settings::OUTSIDE.len()] + 1;
        let (most, count) = efforts(size, first.bin);
        let candidates = bent.and_then(|b| b.candidates.as_ref());
        let bent = bent.and_then(|b| b.light.as_ref());
        let count = match bent {
            Some(light) if light.path_waves() > MANY => count.min(BENT),
            Some(_) if first.size() > WIDE.0 => count.min(efforts(first.size(), first.bin).1),
            Some(_) => count,
            None => count,
        };
        let around = super::coarse::cells(region, first.bin);
        let stands = match candidates {
            Some(candidates) => candidates.drawn(count),
            None => self.candidates(around).drawn(count),
        };
        let reach = if bent.is_some() { size.max(first.size()) } else { size } / 2;
        let samplings = Settings::SAMPLES.into_iter().filter(|m| *m <= most).map(|m| (m, first.bin));
        let sampled = self.shared(samplings, &stands, reach);
        let probing = Probing {
            optics: &self.light,
            colours: &self.colours,
            depth: 0,
            frame: &first.raster,
            lit: &channels.lit,
            scenes: &sampled,
            seen: self.seen(),
            size,
            dense: DENSE,
        };
        let probes = probing.probes(&stands);
        let rules: Vec<_> = Settings::WAVELENGTHS
            .iter()
            .filter(|n| **n <= FINE_WAVELENGTHS)
            .map(|n| (*n, quadrature(self.density, *n, &[0, 1, 2])))
            .collect();
        let coarsest = Settings::NODE_ERRORS[0].min(self.base.node_error);
        let mut nodes = Nodes::coarse(&self.light, 0, &first.raster, around, size, coarsest, DENSE);
        let told = Settings::OUTSIDE.len();
        let of_rays = halves(&self.of_rays[..told]);
        let measuring = Measuring { probing: &probing, probes: &probes, rules: &rules, halves: &of_rays };
        let mut found = measuring.ladders(&mut nodes, target);
        let mut base = self.base;
        if let Some(light) = bent {
            base.diffraction = light.spec.diffraction;
            let colours = self.colours.clone().diffracting(lens, light.spec.diffraction)?;
            let (halves, size) = (halves(&self.widths[..told]), first.size());
            let probing = Probing { optics: light, colours: &colours, size, ..probing };
            let probes = probing.probes(&stands);
            Measuring { probing: &probing, probes: &probes, rules: &rules, halves: &halves }.bend(&mut found);
        }
        if first.bin > 1 {
            found.cells = self.cells(&stands, bent.unwrap_or(&self.light));
        }
        let work = Work { region, channels: channels.lit.len(), planes: channels.sources() };
        Ok((cheapest(&found, target, base, &cost(&work)), found))
    }

    /// By scene, it at each sampling, shared by probes at `stands` whose windows reach `reach` cells.
    pub(super) fn shared(
        &self,
        samplings: impl Iterator<Item = (usize, usize)> + Clone,
        stands: &[Stand],
        reach: usize,
    ) -> Vec<Vec<Shared<'_>>> {
        let of = |(k, scene)| {
            let places = stands.iter().filter(|s| s.scene == k).map(|s| s.region);
            let at = |sampling| Shared::new(self.warped(scene, sampling), places.clone(), reach);
            samplings.clone().map(at).collect()
        };
        self.scenes.iter().enumerate().map(of).collect()
    }

    /// Differences that cells make: against cells half as large, and a third more for what those lack themselves.
    fn cells(&self, stands: &[Stand], light: &Optics) -> Vec<Values> {
        let (lit, bin) = (&self.needs.channels.lit, self.first.bin);
        let nothing = |s: &Stand| vec![0.0; lit.len() * s.region.rows * s.region.cols];
        let pixels = |stand: &Stand| {
            let [row, col] = [stand.region.row, stand.region.col].map(|at| at * bin.cast_signed());
            Region { row, col, rows: SIDE, cols: SIDE }
        };
        let looked = |stand: &&Stand| (stand.region.rows, stand.region.cols) == (SIDE, SIDE);
        let channels = Channels::all();
        // By stand, what cells of a size make there.
        let values = |mut renderer: Renderer| -> Vec<Values> {
            let DepthPlan { bin: own, half_width, samples, raster, .. } = renderer.plan.depths[0].clone();
            let source = |(k, scene)| {
                let seen = stands.iter().filter(looked).filter(|s| s.scene == k);
                let places = seen.map(|s| super::coarse::cells(pixels(s), own));
                let shown = channels.of_texture(scene);
                Shared::new(WarpedScene::new(scene, &light.maps[0], &raster, (samples, own), shown), places, half_width)
            };
            let sources: Vec<Shared<'_>> = self.scenes.iter().enumerate().map(source).collect();
            let steps = (bin / own).cast_signed();
            let one = |stand: &Stand| {
                renderer.plan.depths[0].grid = NodeGrid::single(stand.region.row * steps, stand.region.col * steps);
                let (image, _) =
                    renderer.picture_of::<f32>(&sources[stand.scene], 0, pixels(stand), &channels, &|_| {});
                lit.iter().flat_map(|c| image.index_axis(Axis(0), *c).to_owned()).collect()
            };
            stands.iter().filter(looked).map(one).collect()
        };
        let twins = [bin, bin / 2].map(|b| self.on_cells(b, light));
        let [Some(coarse), Some(fine)] = twins else { return stands.iter().map(nothing).collect() };
        let mut differences = values(coarse).into_iter().zip(values(fine));
        let of = |stand: &Stand| {
            if !looked(&stand) {
                return nothing(stand);
            }
            #[expect(clippy::cast_possible_truncation, reason = "a factor on values of pixels")]
            let scale = (stand.weight.sqrt() * 4.0 / 3.0) as f32;
            let (a, b) = differences.next().unwrap_or_default();
            a.iter().zip(&b).map(|(a, b)| (a - b) * scale).collect()
        };
        stands.iter().map(of).collect()
    }

    /// The lens on cells of `bin` pixels, with one node anywhere; `None` where the frame has no such raster.
    fn on_cells(&self, bin: usize, light: &Optics) -> Option<Renderer> {
        let first = &self.first;
        let depth = DepthPlan {
            bin,
            half_width: first.half_width * first.bin / bin,
            raster: super::coarse::raster(self.frame, bin).ok()?,
            grid: NodeGrid::single(0, 0),
            samples: 1,
            ..first.clone()
        };
        let plan = RenderPlan {
            frame: self.frame.clone(),
            settings: Settings { dense: DENSE, ..Settings::FINE },
            spec: light.spec.clone(),
            table_error: self.table_error,
            depths: vec![depth],
        };
        Some(Renderer::with(light.clone(), plan))
    }
}

/// Seconds of settings, half-width and grid. The convolution's share depends on nodes, window and sampling alone.
fn cost(work: &Work) -> impl Fn(&Settings, usize, &NodeGrid) -> f64 {
    let known = RefCell::new(HashMap::new());
    move |settings, half, grid| {
        let key = (grid.row_knots.len(), grid.col_knots.len(), half, settings.samples);
        let convolution = *known.borrow_mut().entry(key).or_insert_with(|| convolution(work, settings, half, grid));
        seconds(work, settings, half, grid) + convolution
    }
}
