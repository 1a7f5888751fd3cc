//! A lens as the pages of demonstration and design show it, beside others: cross-section, kernels, spots and curves of the lens's own page.

use ndarray::Array3;

use super::atlas::{KernelRequest, Style, colour_kernels, picture};
use super::drawing::lens_svg;
use super::html::{Page, Picture};
use super::lens::{Options, SHIFTS, look, plots, spot_svg};
use super::plot::Plot;
use super::table::significant;
use isoplanat_base::error::Result;
use isoplanat_optics::lens::{Lens, paraxial};

/// Rays of a spot and wavelength.
const RAYS: usize = 400;
/// Curves that are shown, by their names; those by diffraction where waves are asked for.
const WAVES: [&str; 4] = ["mtf_diffraction", "mtf_diffraction_field", "field_curvature", "distortion"];
const NO_WAVES: [&str; 4] = ["mtf", "mtf_field", "field_curvature", "distortion"];

/// A lens as it is shown.
#[derive(Clone, Debug)]
pub struct LensView {
    /// Name.
    pub name: String,
    /// Cross-section (SVG).
    pub drawing: String,
    /// Kernels from the axis to the border, linear RGB.
    pub atlas: Array3<f32>,
    /// Effective focal length, mm.
    pub effective_focal_length_mm: f64,
    /// Effective focal length over entrance-pupil diameter.
    pub f_number: f64,
    /// Spots on the sensor (SVG).
    pub spots: String,
    /// Curves under their names as on the lens's own page.
    pub curves: Vec<(&'static str, Plot)>,
}

impl LensView {
    /// Draws `lens` and computes its kernels, spots and curves for an object at `depth_mm`, `fields` kernels from the axis to the border; MTF by
    /// diffraction if `waves`, else by rays alone, which is much faster for lenses with much blur.
    ///
    /// # Errors
    /// A lens that loses rays its field needs.
    pub fn new(lens: &Lens, depth_mm: f64, fields: usize, waves: bool) -> Result<Self> {
        let request = KernelRequest {
            depth_mm: vec![depth_mm],
            wavelength_nm: Vec::new(),
            weights: Vec::new(),
            fields,
            size: None,
            pitch_mm: lens.sensor.pitch_mm(),
            rays: 8192,
            diffraction: false,
            memory: isoplanat_base::math::memory::Limit::of_process(),
        };
        let first = paraxial::first_order(lens, lens.wavelengths.primary_nm);
        let options = Options {
            rays: RAYS,
            fields_deg: Vec::new(),
            max_angle_deg: None,
            cycles_per_mm: None,
            asked_cycles_per_mm: Vec::new(),
            shift_mm: None,
            shifts: SHIFTS,
            spots: true,
            whole: waves,
            energy: false,
            colour: false,
            psf_depths_mm: Vec::new(),
            memory: isoplanat_base::math::memory::Limit::of_process(),
        };
        let (overview, _) = look(&lens.changed(|l| l.object_vergence = 1.0 / depth_mm)?, &options);
        let shown = if waves { WAVES } else { NO_WAVES };
        Ok(Self {
            name: lens.name.clone(),
            drawing: lens_svg(lens),
            atlas: picture(&colour_kernels(lens, &request)?.kernels, fields, Style::default()),
            effective_focal_length_mm: first.effective_focal_length,
            f_number: first.f_number,
            spots: spot_svg(&overview),
            curves: plots(&overview).into_iter().filter(|(name, _)| shown.contains(name)).collect(),
        })
    }
}

/// A section with every lens below its name; none without lenses.
///
/// # Errors
/// Kernels that are no picture.
pub(super) fn section(page: &mut Page, views: &[(&str, &LensView)]) -> Result<()> {
    if views.is_empty() {
        return Ok(());
    }
    page.section("Lens");
    let caption = |when: &str, v: &LensView| {
        let (focal, number) = (significant(v.effective_focal_length_mm, 5), significant(v.f_number, 3));
        format!("{when}: {}, {focal} mm, f/{number}", v.name)
    };
    let drawings: Vec<_> = views.iter().map(|(when, v)| (v.drawing.clone(), caption(when, v))).collect();
    page.drawings(&drawings, 440);
    page.heading("Point spread functions, from the axis to the border");
    let atlases: Vec<Picture<'_>> = views
        .iter()
        .map(|(when, v)| Picture { image: &v.atlas, caption: (*when).into(), notes: vec![], pixelated: true })
        .collect();
    page.pictures(&atlases, 900)?;
    page.paragraph("Each kernel is scaled to its own peak; the field grows to the right, its outward direction is up.");
    page.heading("Spots");
    let spots: Vec<_> = views.iter().map(|(when, v)| (v.spots.clone(), (*when).to_owned())).collect();
    page.drawings(&spots, 440);
    page.heading("Curves");
    // One curve of all lenses after the other.
    let names = views.first().map(|(_, v)| v.curves.iter().map(|(name, _)| *name).collect::<Vec<_>>());
    let beside = names.unwrap_or_default().into_iter().flat_map(|name| {
        views.iter().filter_map(move |(when, v)| {
            let (_, plot) = v.curves.iter().find(|(n, _)| *n == name)?;
            Some((plot.to_svg(), (*when).to_owned()))
        })
    });
    page.drawings(&beside.collect::<Vec<_>>(), 440);
    page.note("Definitions and accuracy stand on the lens's own page: `isoplanat report`.");
    Ok(())
}
