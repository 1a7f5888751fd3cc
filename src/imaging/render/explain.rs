//! What a plan leaves out, in words and numbers.

use super::choose::{Ladders, bound};
use super::plan::Settings;
use super::probe::Values;
use super::scene_plan::{ScenePlan, Skip};
use crate::imaging::render::blur::Method;
use crate::lens::Lens;

/// The list of a plan; `ladders` give the bounds of what was made coarser.
#[expect(clippy::cast_precision_loss, reason = "shares")]
pub(super) fn skips(plan: &ScenePlan, lens: &Lens, ladders: Option<&Ladders>) -> Vec<Skip> {
    let mut out = Vec::new();
    let mut add = |what, reason: String, remaining: f64, bound: f64| out.push(Skip { what, reason, remaining, bound });
    let share = |a: usize, b: usize| a as f64 / b.max(1) as f64;
    let fine = Settings::FINE;
    let (render, depth) = (&plan.renderer.plan, &plan.renderer.plan.depths[0]);
    let s = &render.settings;
    let table = &plan.renderer.optics.table;
    let found = |off: Option<&Vec<Values>>| off.map_or(f64::NAN, |o| bound(o));
    let distance = if depth.vergence > 0.0 { format!("{:.0} mm", 1.0 / depth.vergence) } else { "infinity".into() };
    add("depths", format!("all of the scene stands at {distance}: one grid of PSFs"), 1.0, 0.0);
    let pixels = render.frame.rows * render.frame.columns;
    let kept = plan.region.map_or(0, |r| r.rows * r.cols);
    if kept < pixels {
        let reason = format!(
            "light lands on {kept} of {pixels} pixels at most ({:.1} % of the frame's squares are lit); the rest is black",
            100.0 * plan.needs.lit_share
        );
        add("unlit part of the frame", reason, share(kept, pixels), 0.0);
    } else if plan.needs.lit_share < 1.0 {
        let reason = format!(
            "{:.1} % of the frame's squares are lit; blocks without light are passed over",
            100.0 * plan.needs.lit_share
        );
        add("unlit blocks", reason, plan.needs.lit_share, 0.0);
    }
    let lit = plan.needs.channels.lit.len();
    if lit < 3 {
        add("dark channels", format!("{lit} of 3 channels hold light"), share(lit, 3), 0.0);
    }
    if plan.needs.channels.grey && lit > 1 {
        add("colours of the scene", "all channels are the same: one is sampled and transformed".into(), 1.0 / 3.0, 0.0);
    }
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
        add("apertures", reason, share(clipping.len(), apertures), 0.0);
    }
    let (fields, nodes) = (table.spec.radii_mm.len(), depth.grid.len());
    let reason = format!(
        "rotational symmetry: {fields} sensor radii, half the stop each, serve all nodes (rays within {:.1e} pixel)",
        render.table_error.landing_mm / render.frame.pitch_mm
    );
    add("fields off the meridian", reason, (share(fields, 2 * nodes.max(fields))).min(0.5), 0.0);
    let full = share(render.frame.rows, 32).ceil().mul_add(share(render.frame.columns, 32).ceil(), 0.0);
    let off = ladders.and_then(|l| l.nodes.iter().rev().find(|r| r.setting.0 >= s.node_error)).map(|r| &r.off);
    if nodes == 1 {
        let reason =
            format!("the PSF is the same all over the picture to {:.1} % (relative L2)", 100.0 * depth.node_error);
        add("PSF nodes", reason, 1.0 / full, found(off));
    } else {
        let reason = format!(
            "{} × {} nodes where the PSF changes; interpolated kernels are within {:.1} % (relative L2)",
            depth.grid.row_knots.len(),
            depth.grid.col_knots.len(),
            100.0 * depth.node_error
        );
        add("PSF nodes", reason, nodes as f64 / full, found(off));
    }
    let off = ladders.and_then(|l| l.wavelengths.iter().find(|r| r.setting >= s.wavelengths)).map(|r| &r.off);
    if s.wavelengths < fine.wavelengths {
        let reason = format!("{} of {} wavelengths tell this scene's colours apart", s.wavelengths, fine.wavelengths);
        add("wavelengths", reason, share(s.wavelengths, fine.wavelengths), found(off));
    }
    let off =
        ladders.and_then(|l| l.samples.iter().find(|r| r.setting >= s.samples).or(l.samples.last())).map(|r| &r.off);
    if s.samples < fine.samples {
        let reason =
            format!("the blurred scene needs {0} × {0} samples a pixel, not {1} × {1}", s.samples, fine.samples);
        add("scene samples", reason, share(s.samples * s.samples, fine.samples * fine.samples), found(off));
    }
    let off = ladders.and_then(|l| l.dense.iter().find(|r| r.setting >= s.dense)).map(|r| &r.off);
    if s.dense < fine.dense {
        add(
            "pupil points",
            format!("{} of {} points a beam", s.dense, fine.dense),
            share(s.dense, fine.dense),
            found(off),
        );
    }
    let size = depth.size();
    let unit = if depth.bin == 1 { "pixels".to_owned() } else { format!("cells of {0} × {0} pixels", depth.bin) };
    if depth.bin > 1 {
        let reason =
            format!("kernels are {} pixels wide: the picture is smooth, and computed on {unit}", size * depth.bin);
        add("pixels", reason, 1.0 / share(depth.bin * depth.bin, 1), plan.coarse_bound);
    }
    if plan.method == Method::Direct {
        add("transforms", format!("kernels of {size} × {size} {unit} are cheaper summed directly"), 0.0, 0.0);
    }
    let off = ladders.and_then(|l| l.windows.iter().find(|r| r.setting.1 >= depth.half_width)).map(|r| &r.off);
    let reason = format!("{size} × {size} {unit} hold all but {:.1e} of every beam", s.outside);
    add("light outside the kernels", reason, 1.0, found(off));
    out
}
