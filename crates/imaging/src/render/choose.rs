//! The cheapest setting whose predicted error holds.

use rayon::prelude::*;

use super::nodes::Nodes;
use super::plan::Settings;
use super::probe::{Cache, Probe, Probing, Values};
use crate::metrics::decibel;
use crate::render::node_grid::NodeGrid;
use isoplanat_optics::psf::Quadrature;

/// Factor on the predicted mean square error that a choice must still hold with: probes are few.
pub(crate) const MARGIN: f64 = 1.5;

/// Share of the asked mean square that the finest step of a ladder may leave: finer ones are not measured then.
const LEFT: f64 = 5e-3;

/// One step of one approximation's ladder: its setting and, by probe, its differences to the exact values.
#[derive(Clone, Debug)]
pub(crate) struct Rung<S> {
    /// The setting.
    pub setting: S,
    /// Differences, one list a probe.
    pub off: Vec<Values>,
}

impl<S> Rung<S> {
    /// Mean square of the differences.
    pub(crate) fn mean_square(&self) -> f64 {
        mean_square(&[&self.off]).0
    }
}

/// All ladders of a scene.
pub(crate) struct Ladders {
    /// Scene samples a pixel.
    pub samples: Vec<Rung<usize>>,
    /// Wavelengths.
    pub wavelengths: Vec<Rung<usize>>,
    /// Dense pupil points.
    pub dense: Vec<Rung<usize>>,
    /// Kernel half-widths, with the share that falls outside.
    pub windows: Vec<Rung<(f64, usize)>>,
    /// Node grids, with the interpolation error they were made for and the one they have.
    pub nodes: Vec<Rung<(f64, f64, NodeGrid)>>,
    /// What cells larger than pixels make, whatever else is chosen; nothing where cells are pixels.
    pub cells: Vec<Values>,
}

impl Ladders {
    /// Predicted mean square error of `settings` with kernels of half-width `half`, where all of their rungs were measured, and
    /// its standard error.
    pub(crate) fn predicted(&self, settings: &Settings, half: usize) -> Option<(f64, f64)> {
        let parts: [&[Values]; 6] = [
            &self.nodes.iter().find(|r| r.setting.0 <= settings.node_error)?.off,
            &self.windows.iter().find(|r| r.setting.1 >= half).or(self.windows.last())?.off,
            &self.samples.iter().find(|r| r.setting >= settings.samples).or(self.samples.last())?.off,
            &self.dense.iter().find(|r| r.setting >= settings.dense).or(self.dense.last())?.off,
            &self.wavelengths.iter().find(|r| r.setting >= settings.wavelengths).or(self.wavelengths.last())?.off,
            &self.cells,
        ];
        Some(mean_square(&parts))
    }
}

/// The bound that a measured rung stands for: root of its mean square with standard error and margin.
pub(crate) fn bound(off: &[Values]) -> f64 {
    let (mean, error) = mean_square(&[off]);
    (MARGIN * mean + error).sqrt()
}

/// Mean square over all values of the sum of `parts` (lists by probe), and its standard error over the probes.
#[expect(clippy::cast_precision_loss, reason = "small counts")]
pub(crate) fn mean_square(parts: &[&[Values]]) -> (f64, f64) {
    let Some(first) = parts.first() else { return (0.0, 0.0) };
    let each: Vec<f64> = (0..first.len())
        .map(|p| {
            let n = first[p].len();
            let square = |k: usize| parts.iter().map(|part| f64::from(part[p][k])).sum::<f64>().powi(2);
            (0..n).map(square).sum::<f64>() / n.max(1) as f64
        })
        .collect();
    let n = each.len().max(1) as f64;
    let mean = each.iter().sum::<f64>() / n;
    let variance = each.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0).max(1.0);
    (mean, (variance / n).sqrt())
}

/// The PSNR to predict, dB in linear light for a range of 1, of a mean square over probes with its standard error: twice the error
/// is added. Few places of a picture make most of its error, so that the mean over probes is more often too small than too large.
pub(crate) fn told((mean, error): (f64, f64)) -> f64 {
    decibel(mean + 2.0 * error)
}

/// What was chosen.
#[derive(Clone, Debug)]
pub(crate) struct Choice {
    /// The settings.
    pub settings: Settings,
    /// Kernel half-width, pixels.
    pub half_width: usize,
    /// Nodes.
    pub grid: NodeGrid,
    /// Interpolation error between nodes that was seen, relative L2.
    pub node_error: f64,
    /// Predicted PSNR ([`told`]).
    pub psnr_db: f64,
    /// Whether it holds the request (with the margin).
    pub holds: bool,
}

/// What the ladders are measured with.
pub(crate) struct Measuring<'a, 'b> {
    /// The fine lens.
    pub probing: &'a Probing<'b>,
    /// Exact values of a few places.
    pub probes: &'a [Probe],
    /// Quadratures of [`Settings::WAVELENGTHS`].
    pub rules: &'a [(usize, Quadrature)],
    /// Half-widths of the kernels for [`Settings::OUTSIDE`], cells.
    pub halves: &'a [usize],
}

impl Measuring<'_, '_> {
    /// Measures every ladder. `nodes` has been made coarse and is refined until its error is a small part of `budget` (a mean
    /// square), or all of [`Settings::NODE_ERRORS`] are done.
    pub(crate) fn ladders(&self, nodes: &mut Nodes<'_>, budget: f64) -> Ladders {
        Ladders {
            samples: self.samples(budget),
            wavelengths: self.wavelengths(),
            dense: self.dense(budget),
            windows: self.windows(),
            nodes: self.nodes(nodes, budget),
            cells: self.nothing(),
        }
    }

    /// Puts what kernels by diffraction tell, of which these probes are made, in the place of what those of rays told: wavelengths and windows. Samples of the scene and
    /// nodes stay as rays ask for them, whose kernels are sharper, and so do points of the stop, of which kernels of hundreds of waves are made.
    pub(crate) fn bend(&self, found: &mut Ladders) {
        found.wavelengths = self.wavelengths();
        found.windows = self.windows();
    }

    fn wavelengths(&self) -> Vec<Rung<usize>> {
        let wavelength = |(n, rule): &(usize, Quadrature)| Rung {
            setting: *n,
            off: self.each(&|p| self.probing.wavelengths(p, rule)),
        };
        self.rules.iter().map(wavelength).collect()
    }

    fn each(&self, f: &(dyn Fn(&Probe) -> Values + Sync)) -> Vec<Values> {
        self.probing.each(self.probes, f)
    }

    fn nothing(&self) -> Vec<Values> {
        self.probes.iter().map(|p| vec![0.0; p.coarse.len()]).collect()
    }

    /// Scene samples a pixel, up to a sampling that leaves a small part of `budget`: the error falls as the square of the
    /// samples, and what the finest leaves is told by the one before it.
    fn samples(&self, budget: f64) -> Vec<Rung<usize>> {
        let probing = self.probing;
        let count = |k: usize| probing.scenes[0][k].scene.samples();
        let square = |k: usize| (count(k) as f32).powi(-2);
        let mut values: Vec<Vec<Values>> = vec![self.probes.iter().map(|p| p.coarse.clone()).collect()];
        // Differences of sampling `k` to the last, made those to none at all.
        let off = |values: &[Vec<Values>], k: usize| -> Vec<Values> {
            let fine = values.len() - 1;
            let (from, scale) = if k < fine {
                (k, square(k) / (square(k) - square(fine)))
            } else {
                (fine - 1, square(fine) / (square(fine - 1) - square(fine)))
            };
            let pairs = values[from].iter().zip(&values[fine]).zip(self.probes);
            pairs.map(|((a, b), p)| p.less(a.clone(), b).into_iter().map(|v| v * scale).collect()).collect()
        };
        for which in 1..probing.scenes[0].len() {
            let form = probing.form(probing.optics, probing.dense, count(which));
            values.push(self.each(&|p| probing.sampled(p, which, &form)));
            // Samples that miss the same texels agree.
            if count(which) >= probing.seen && mean_square(&[&off(&values, which)]).0 < LEFT * budget {
                break;
            }
        }
        if values.len() == 1 {
            return vec![Rung { setting: count(0), off: self.nothing() }];
        }
        (0..values.len()).map(|k| Rung { setting: count(k), off: off(&values, k) }).collect()
    }

    /// Kernel windows: those of the shares, each once.
    fn windows(&self) -> Vec<Rung<(f64, usize)>> {
        let probing = self.probing;
        let mut halves: Vec<(f64, usize)> = Vec::new();
        for (share, half) in Settings::OUTSIDE.into_iter().zip(self.halves) {
            let half = (*half).min(probing.size / 2);
            if halves.last().is_none_or(|(_, h)| *h < half) {
                halves.push((share, half));
            } else if let Some(last) = halves.last_mut() {
                last.0 = share;
            }
        }
        let sizes: Vec<usize> = halves.iter().map(|(_, h)| 2 * h + 1).collect();
        let by_probe: Vec<Vec<Values>> = self.probes.par_iter().map(|p| probing.windows(p, &sizes)).collect();
        let off = |k: usize| by_probe.iter().map(|v| v[k].clone()).collect();
        halves.into_iter().enumerate().map(|(k, setting)| Rung { setting, off: off(k) }).collect()
    }

    /// Values with `dense` points; few wavelengths tell.
    fn through(&self, dense: usize) -> Vec<Values> {
        let form = self.probing.form(self.probing.optics, dense, 1);
        self.each(&|p| self.probing.through(p, self.probing.optics, &form))
    }

    /// Dense points, against the fewest whose own error is a small part of `budget`, or the most.
    fn dense(&self, budget: f64) -> Vec<Rung<usize>> {
        let mut values: Vec<Vec<Values>> = Vec::new();
        let off = |a: &[Values], b: &[Values]| -> Vec<Values> {
            a.iter().zip(b).zip(self.probes).map(|((a, b), p)| p.less(a.clone(), b)).collect()
        };
        for dense in Settings::DENSE {
            values.push(self.through(dense));
            // Twice the points leave half the error or less: what the last step changed is more than what is left.
            if let [.., a, b] = &values[..]
                && mean_square(&[&off(a, b)]).0 < LEFT * budget
            {
                break;
            }
        }
        let finest = &values[values.len() - 1];
        Settings::DENSE.iter().zip(&values).map(|(n, v)| Rung { setting: *n, off: off(v, finest) }).collect()
    }

    fn nodes(&self, nodes: &mut Nodes<'_>, budget: f64) -> Vec<Rung<(f64, f64, NodeGrid)>> {
        let Self { probing, probes, .. } = self;
        let (mut steps, mut cache) = (Vec::new(), Cache::new());
        for tolerance in Settings::NODE_ERRORS {
            nodes.refine(tolerance);
            probing.prepare(probes, probing.optics, probing.dense, &nodes.grid, &mut cache);
            let off: Vec<Values> =
                probes.par_iter().map(|p| probing.nodes(p, &p.coarse, &nodes.grid, &cache)).collect();
            let rung = Rung { setting: (tolerance, nodes.error, nodes.grid.clone()), off };
            // What halving an interval again would win is small beside the budget, or there is one node for all.
            let enough = rung.mean_square() < 0.1 * budget || nodes.grid.len() == 1;
            steps.push(rung);
            if enough {
                break;
            }
        }
        steps
    }
}

/// The cheapest combination by `cost` (seconds of the settings, half-width and grid) whose mean square error, times
/// [`MARGIN`] and with its standard error added, is at most `budget`; the best there is, if none holds.
pub(crate) fn cheapest(
    ladders: &Ladders,
    budget: f64,
    base: Settings,
    cost: &dyn Fn(&Settings, usize, &NodeGrid) -> f64,
) -> Choice {
    let mut best: Option<(f64, Choice)> = None;
    let mut finest: Option<(f64, Choice)> = None;
    for nodes in &ladders.nodes {
        for windows in &ladders.windows {
            for samples in &ladders.samples {
                for dense in &ladders.dense {
                    for wavelengths in &ladders.wavelengths {
                        let parts: [&[Values]; 6] =
                            [&nodes.off, &windows.off, &samples.off, &dense.off, &wavelengths.off, &ladders.cells];
                        let settings = Settings {
                            samples: samples.setting,
                            wavelengths: wavelengths.setting,
                            dense: dense.setting,
                            node_error: nodes.setting.0,
                            outside: windows.setting.0,
                            ..base
                        };
                        let seconds = cost(&settings, windows.setting.1, &nodes.setting.2);
                        let no_better =
                            |found: &Option<(f64, Choice)>, v: f64| found.as_ref().is_some_and(|b| b.0 <= v);
                        if no_better(&best, seconds) {
                            continue;
                        }
                        let (mean, error) = mean_square(&parts);
                        let holds = MARGIN * mean + error <= budget;
                        let choice = Choice {
                            settings,
                            half_width: windows.setting.1,
                            grid: nodes.setting.2.clone(),
                            node_error: nodes.setting.1,
                            psnr_db: told((mean, error)),
                            holds,
                        };
                        if holds {
                            best = Some((seconds, choice));
                        } else if !no_better(&finest, mean) {
                            finest = Some((mean, choice));
                        }
                    }
                }
            }
        }
    }
    best.or(finest).expect("ladders have rungs").1
}
