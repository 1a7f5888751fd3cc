//! What a plan leaves out, in words and numbers.

use super::choose::{Ladders, Rung, bound};
use super::plan::Settings;
use super::scene_plan::{ScenePlan, Skip};
use crate::render::blur::Method;
use isoplanat_optics::lens::Lens;
use isoplanat_optics::psf::Model;

/// The list of a plan; `ladders` give the bounds of what was made coarser.
pub(super) fn skips(plan: &ScenePlan, lens: &Lens, ladders: Option<&Ladders>) -> Vec<Skip> {
    let mut list = List { plan, ladders, skips: Vec::new() };
    list.of_the_scene();
    list.of_the_lens(lens);
    list.nodes();
    list.diffraction();
    list.of_the_settings();
    list.kernels();
    list.skips
}

#[expect(clippy::cast_precision_loss, reason = "shares")]
fn share(a: usize, b: usize) -> f64 {
    a as f64 / b.max(1) as f64
}

struct List<'a> {
    plan: &'a ScenePlan,
    ladders: Option<&'a Ladders>,
    skips: Vec<Skip>,
}

impl<'a> List<'a> {
    fn add(&mut self, what: &'static str, reason: String, remaining: f64, bound: f64) {
        self.skips.push(Skip { what, reason, remaining, bound });
    }

    /// The bound of the rung that `find` finds; no number where nothing was measured.
    fn found<S: 'a>(&self, find: impl Fn(&'a Ladders) -> Option<&'a Rung<S>>) -> f64 {
        self.ladders.and_then(find).map_or(f64::NAN, |rung| bound(&rung.off))
    }

    fn of_the_scene(&mut self) {
        let (render, needs) = (&self.plan.renderer.plan, &self.plan.needs);
        let vergence = render.depths[0].vergence;
        let distance = if vergence > 0.0 { format!("{:.0} mm", 1.0 / vergence) } else { "infinity".into() };
        self.add("depths", format!("all of the scene stands at {distance}: one grid of PSFs"), 1.0, 0.0);
        let pixels = render.frame.rows * render.frame.columns;
        let kept = self.plan.region.map_or(0, |r| r.rows * r.cols);
        if kept < pixels {
            let reason = format!(
                "light lands on {kept} of {pixels} pixels at most ({:.1} % of the frame's squares are lit); the rest is black",
                100.0 * needs.lit_share
            );
            self.add("unlit part of the frame", reason, share(kept, pixels), 0.0);
        } else if needs.lit_share < 1.0 {
            let reason = format!(
                "{:.1} % of the frame's squares are lit; blocks without light are passed over",
                100.0 * needs.lit_share
            );
            self.add("unlit blocks", reason, needs.lit_share, 0.0);
        }
        let lit = needs.channels.lit.len();
        if lit < 3 {
            self.add("dark channels", format!("{lit} of 3 channels hold light"), share(lit, 3), 0.0);
        }
        if needs.channels.grey && lit > 1 {
            let reason = "all channels are the same: one is sampled and transformed".into();
            self.add("colours of the scene", reason, 1.0 / 3.0, 0.0);
        }
    }

    fn of_the_lens(&mut self, lens: &Lens) {
        let (render, table) = (&self.plan.renderer.plan, self.plan.renderer.optics.table());
        let clipping: Vec<String> = table.clips.iter().map(|k| (k + 1).to_string()).collect();
        let apertures = lens.surfaces.iter().enumerate();
        let apertures = apertures.filter(|(k, s)| *k != lens.stop && s.semi_diameter.is_finite()).count();
        if clipping.len() < apertures {
            let clip = if clipping.is_empty() {
                "none comes near".into()
            } else {
                format!("surface {} comes near", clipping.join(", "))
            };
            let reason = format!("of {apertures} clear apertures beside the stop, {clip} a beam of this field");
            self.add("apertures", reason, share(clipping.len(), apertures), 0.0);
        }
        let (fields, nodes) = (table.spec.radii_mm.len(), render.depths[0].grid.len());
        let reason = format!(
            "rotational symmetry: {fields} sensor radii, half the stop each, serve all nodes (rays within {:.1e} pixel)",
            render.table_error.landing_mm / render.frame.pitch_mm
        );
        self.add("fields off the meridian", reason, share(fields, 2 * nodes.max(fields)).min(0.5), 0.0);
    }

    fn nodes(&mut self) {
        let render = &self.plan.renderer.plan;
        let depth = &render.depths[0];
        let full = share(render.frame.rows, 32).ceil() * share(render.frame.columns, 32).ceil();
        let off = self.found(|l| l.nodes.iter().rev().find(|r| r.setting.0 >= render.settings.node_error));
        let (nodes, error) = (depth.grid.len(), 100.0 * depth.node_error);
        let reason = if nodes == 1 {
            format!("the PSF is the same all over the picture to {error:.1} % (relative L2)")
        } else {
            let (down, across) = (depth.grid.row_knots.len(), depth.grid.col_knots.len());
            format!(
                "{down} × {across} nodes where the PSF changes; interpolated kernels are within {error:.1} % (relative L2)"
            )
        };
        self.add("PSF nodes", reason, share(nodes, 1) / full, off);
    }

    fn diffraction(&mut self) {
        // Pictures of rays that were asked for lack nothing.
        let Some(bound) = self.plan.bend_bound else { return };
        let convolved = self.plan.renderer.plan.settings.diffraction.diffracts();
        let reason = match bound.is_finite() {
            true if convolved => "kernels of rays, convolved with the open pupil's diffraction, are enough",
            true => "blur of rays and pixels hide what bends at the stop",
            false => "rays for it do not get through this lens",
        };
        self.add(
            if convolved { "diffraction with path differences" } else { "diffraction" },
            reason.to_owned(),
            0.0,
            bound,
        );
    }

    fn of_the_settings(&mut self) {
        let (s, fine) = (self.plan.renderer.plan.settings, Settings::FINE);
        if s.wavelengths < fine.wavelengths {
            let reason =
                format!("{} of {} wavelengths tell this scene's colours apart", s.wavelengths, fine.wavelengths);
            let off = self.found(|l| l.wavelengths.iter().find(|r| r.setting >= s.wavelengths));
            self.add("wavelengths", reason, share(s.wavelengths, fine.wavelengths), off);
        }
        if s.samples < fine.samples {
            let reason =
                format!("the blurred scene needs {0} × {0} samples a pixel, not {1} × {1}", s.samples, fine.samples);
            let off = self.found(|l| l.samples.iter().find(|r| r.setting >= s.samples).or(l.samples.last()));
            self.add("scene samples", reason, share(s.samples * s.samples, fine.samples * fine.samples), off);
        }
        if s.dense < fine.dense && s.diffraction != Model::Waves {
            let reason = format!("{} of {} points a beam", s.dense, fine.dense);
            let off = self.found(|l| l.dense.iter().find(|r| r.setting >= s.dense).or(l.dense.last()));
            self.add("pupil points", reason, share(s.dense, fine.dense), off);
        }
    }

    fn kernels(&mut self) {
        let (depth, outside) = (&self.plan.renderer.plan.depths[0], self.plan.renderer.plan.settings.outside);
        let (size, bin) = (depth.size(), depth.bin);
        let unit = if bin == 1 { "pixels".to_owned() } else { format!("cells of {bin} × {bin} pixels") };
        if bin > 1 {
            let reason =
                format!("kernels are {} pixels wide: the picture is smooth, and computed on {unit}", size * bin);
            self.add("pixels", reason, 1.0 / share(bin * bin, 1), self.plan.coarse_bound);
        }
        if self.plan.method == Method::Direct {
            self.add("transforms", format!("kernels of {size} × {size} {unit} are cheaper summed directly"), 0.0, 0.0);
        }
        let off = self.found(|l| l.windows.iter().find(|r| r.setting.1 >= depth.half_width));
        let mut reason = format!("{size} × {size} {unit} hold all but {outside:.1e} of every beam");
        if self.plan.renderer.optics.spec.diffraction.diffracts() {
            reason.push_str("; light that bends farther is spread evenly over them");
        }
        self.add("light outside the kernels", reason, 1.0, off);
    }
}
