//! `--show-kit`: what a kit holds.

use crate::kit::Kit;
use isoplanat_base::error::Result;
use isoplanat_base::figures::significant;
use isoplanat_base::terminal::in_line;
use isoplanat_imaging::guide::Filters;
use serde_json::json;

use crate::program::say::say;

/// What the network sees, and which scenes its filters are for.
fn told(kit: &Kit) -> String {
    let names = kit.card.inputs.names();
    if names.is_empty() {
        return "sees the capture alone".into();
    }
    let facts = kit.guide.facts().map_or(String::new(), |facts| {
        let depths: Vec<String> = facts.depths_mm().iter().map(|d| significant(*d, 6)).collect();
        let range = match depths.as_slice() {
            [] => "distances that the file does not state".into(),
            some => format!("objects at {} mm; others are taken to lie there", some.join(", ")),
        };
        let of_bank = |f: &Filters, noise: &str| {
            let size = 2 * f.reach() + 1;
            format!(
                "{} Wiener filters of {size} × {size} pixels a colour{noise}, which ring by at most {:.2} of the range of a capture; ",
                f.grid.len(),
                f.overshoot()
            )
        };
        let own = facts.filters.iter().map(|f| of_bank(f, ""));
        let levels = facts.levels.iter().flat_map(|l| l.iter().zip([" for a tenth of the noise", " for ten times the noise"]));
        format!(" ({}for {range})", own.chain(levels.map(|(f, noise)| of_bank(f, noise))).collect::<String>())
    });
    format!("sees {} beside the capture{facts}", names.join(", "))
}

/// Prints a kit, as lines or as JSON.
pub(crate) fn show_kit(kit: &Kit, as_json: bool) -> Result<()> {
    let tiling = kit.tiling()?;
    if as_json {
        let (card, distortion) = (&kit.card, &kit.distortion);
        let shown = json!({
            "schema": 1,
            "name": kit.name,
            "created_by": kit.created_by,
            "lens": kit.lens,
            "model": kit.model,
            "filters": kit.filters.as_ref().map(|(entry, _)| entry),
            "card": card,
            "frame": kit.frame,
            "distortion": distortion,
            "glare": kit.glare,
            "valid": kit.valid,
            "shading": kit.shading,
            "sensor": kit.sensor,
        });
        say(&format!("{shown:#}"));
        return Ok(());
    }
    let frame = &kit.frame;
    let edge = kit.distortion.sensor_from_slope(kit.distortion.max_slope);
    let ideal = kit.distortion.sensor_from_slope_derivative(0.0) * kit.distortion.max_slope;
    let corner = kit.shading.illumination.each_ref().map(|v| format!("{:.3}", v[v.len() - 1]));
    let lines = [
        format!("kit        {} (by {})", kit.name, kit.created_by),
        format!("lens       {} ({})", kit.lens.name, kit.lens.sha256),
        format!(
            "network    {}, {} scales, {} channels at the finest, {} blocks",
            kit.card.name,
            kit.card.scales,
            kit.card.base_width,
            kit.card.blocks.name()
        ),
        format!("told       {}", told(kit)),
        format!("model      {} ({} kB, {})", kit.model.file, kit.model_bytes.len() / 1000, kit.model.sha256),
        format!(
            "tiles      {} px, overlap {} px, {:.0} % of the work kept",
            tiling.tile(),
            kit.model.overlap_px,
            100.0 * tiling.efficiency()
        ),
        format!("demosaic   {}", kit.card.demosaic),
        format!(
            "frame      {} × {} px of {} µm, axis at column {}, row {}",
            frame.columns,
            frame.rows,
            frame.pitch_mm * 1e3,
            frame.axis_px[0],
            frame.axis_px[1]
        ),
        format!(
            "distortion {:+.2} % at {:.1}°, residual {:.4} mm",
            100.0 * (edge / ideal - 1.0),
            kit.distortion.max_slope.atan().to_degrees(),
            kit.distortion.residual_mm
        ),
        format!(
            "glare      {}",
            kit.glare.map_or("not measured".into(), |g| format!("{:.1} % of the light", 100.0 * g))
        ),
        format!("valid for  {}", kit.valid.told()),
        format!("shading    {} at the last radius (R, G, B)", corner.join(", ")),
        format!(
            "sensor     {}, {}, {} bits, black {}, white {}",
            kit.sensor.name, kit.sensor.cfa, kit.sensor.bits, kit.sensor.black_level, kit.sensor.white_level
        ),
    ];
    let lines: Vec<_> = lines.iter().map(|line| in_line(line)).collect();
    say(&lines.join("\n"));
    Ok(())
}
