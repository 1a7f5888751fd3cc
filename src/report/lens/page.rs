//! The sections of the page: one lens, or two side by side.

use super::curves::{PATHS, RAYS, diffraction, frequency};
use super::spots::{half_side, panels};
use super::{Atlas, LensReport, bars, grid, spot_table, waves};
use crate::report::atlas::{Style, picture};
use crate::report::drawing::lens_svg_within;
use crate::report::html::{Fact, Page, Picture};
use crate::report::listing::{Listing, curved_sensor};
use crate::report::measured::TILT_DEG;
use crate::report::plot::Plot;
use crate::report::table::{Table, significant};
use isoplanat_base::error::Result;
use isoplanat_optics::lens::paraxial::first_order;
use isoplanat_optics::lens::seidel;

/// Decades of the logarithmic atlas.
const DECADES: f32 = 4.0;
/// Surfaces up to which sums are shown as bars.
const MOST_BARS: usize = 32;

/// The page of `reports`: one lens, or several beside each other.
///
/// # Errors
/// Pictures that cannot be encoded.
pub fn html(reports: &[LensReport]) -> Result<String> {
    let names: Vec<&str> = reports.iter().map(|r| r.lens.name.as_str()).collect();
    let subtitle = match reports {
        [one] => one.lens.source.clone(),
        _ => "Side by side: each row shows the lenses in this order.".to_owned(),
    };
    let mut page = Page::new(&names.join(" · "), &subtitle);
    let pages = Pages { reports, plots: reports.iter().map(LensReport::plots).collect() };
    pages.summary(&mut page);
    pages.layout(&mut page);
    pages.third_order(&mut page);
    pages.spots(&mut page);
    pages.fans(&mut page);
    pages.waves(&mut page)?;
    pages.field(&mut page);
    pages.kernels(&mut page)?;
    pages.mtf(&mut page);
    pages.measured(&mut page)?;
    pages.health(&mut page);
    pages.accuracy(&mut page);
    Ok(page.finish_with_contents())
}

/// What all sections read.
struct Pages<'a> {
    reports: &'a [LensReport],
    plots: Vec<Vec<(&'static str, Plot)>>,
}

/// A fact, if its value is a number.
fn fact(value: f64, digits: usize, unit: &str, label: &str) -> Option<Fact> {
    let value = value.is_finite().then(|| format!("{}{unit}", significant(value, digits)))?;
    Some(Fact { value, label: label.to_owned() })
}

/// Largest size of the cross-section, px.
const LAYOUT: [f64; 2] = [620.0, 440.0];

/// An object distance in words.
fn distance(mm: f64) -> String {
    if mm.is_finite() { format!("{} mm", significant(mm, 4)) } else { "infinity".to_owned() }
}

impl Pages<'_> {
    /// What stands before a lens's own part where there are several.
    fn named(&self, page: &mut Page, report: &LensReport) {
        if self.reports.len() > 1 {
            page.heading(&report.lens.name);
        }
    }

    /// The plot `name` of every lens.
    fn plot(&self, name: &str) -> Vec<(String, String)> {
        let several = self.reports.len() > 1;
        let caption = |r: &LensReport| if several { r.lens.name.clone() } else { String::new() };
        let found = self.plots.iter().zip(self.reports).filter_map(|(plots, r)| {
            let (_, plot) = plots.iter().find(|(n, _)| *n == name)?;
            Some((plot.to_svg(), caption(r)))
        });
        found.collect()
    }

    fn summary(&self, page: &mut Page) {
        for r in self.reports {
            self.named(page, r);
            let f = first_order(&r.lens, r.overview.primary_nm);
            let largest = |values: &mut dyn Iterator<Item = f64>| {
                values.fold(f64::NAN, |m, v| if m.is_nan() || v.abs() > m.abs() { v } else { m })
            };
            let end = r.overview.curve.last();
            let light = r.illumination.iter().map(|p| p[1]).fold(f64::NAN, f64::min);
            let passes = r.check.0;
            let facts = [
                fact(f.effective_focal_length, 5, " mm", "focal length"),
                fact(f.working_f_number, 4, "", "working f-number"),
                fact(end.map_or(f64::NAN, |e| e.angle_deg), 4, "°", "half field shown"),
                fact(r.lens.length(), 5, " mm", "first vertex to sensor"),
                fact(
                    1e3 * largest(&mut r.overview.fields.iter().filter_map(|f| Some(f.rms?.value))),
                    4,
                    " µm",
                    "largest rms spot radius",
                ),
                fact(
                    largest(&mut r.overview.curve.iter().map(|c| c.distortion_percent)),
                    3,
                    " %",
                    "largest distortion",
                ),
                fact(100.0 * light, 3, " %", "least relative illumination"),
                Some(Fact { value: if passes { "passed" } else { "failed" }.into(), label: "numerical check".into() }),
            ];
            page.facts(&facts.into_iter().flatten().collect::<Vec<_>>());
            if let Some(line) = curved_sensor(&r.lens) {
                page.paragraph(&format!("{line} What is said of the image plane is said of it."));
            }
            if !r.missing.is_empty() {
                page.paragraph("Not shown, or not whole:");
                page.list(&r.missing);
            }
        }
    }

    fn layout(&self, page: &mut Page) {
        page.section("Layout");
        for r in self.reports {
            self.named(page, r);
            let listing = Listing::new(&r.lens, r.overview.primary_nm);
            let drawing = lens_svg_within(&r.lens, LAYOUT);
            page.drawing_beside(&drawing, "First-order data", &listing.first_order_table());
            page.note("Rays through the real stop; those that a clear aperture stops end there and are drawn faintly.");
            page.heading("Surfaces");
            page.table(&listing.surface_table());
            page.heading("Media");
            page.table(&listing.media_table());
        }
    }

    fn third_order(&self, page: &mut Page) {
        page.section("Third-order sums");
        let names = [
            "S_I spherical",
            "S_II coma",
            "S_III astigmatism",
            "S_IV Petzval",
            "S_V distortion",
            "C_I axial",
            "C_II lateral",
        ];
        for r in self.reports {
            self.named(page, r);
            let sums = seidel::per_surface(&r.lens, r.overview.primary_nm);
            if sums.len() <= MOST_BARS {
                let microns = |s: seidel::Seidel| s.to_array().map(|v| 1e3 * v).to_vec();
                let mut groups: Vec<_> = sums.iter().enumerate().map(|(i, s)| (i.to_string(), microns(*s))).collect();
                groups.push(("sum".into(), microns(seidel::total(&sums))));
                page.drawings(&[(bars::bars("By surface", "µm", &names, &groups), String::new())], 520);
            }
            page.table(&Listing::new(&r.lens, r.overview.primary_nm).seidel_table());
        }
        page.note("Welford's sums at full aperture and field, primary wavelength; colour between the shortest and the longest wavelength. Wave aberration at the rim: S_I/8 and so on.");
    }

    fn spots(&self, page: &mut Page) {
        page.section("Spots");
        for r in self.reports {
            self.named(page, r);
            let o = &r.overview;
            let half = half_side(o);
            let figures: Vec<(String, String)> = o
                .shifts_mm
                .iter()
                .map(|z| {
                    let place = if *z == 0.0 {
                        "On the sensor.".to_owned()
                    } else {
                        format!(
                            "{} µm {} the sensor.",
                            significant(1e3 * z.abs(), 3),
                            if *z > 0.0 { "behind" } else { "before" }
                        )
                    };
                    (panels(o, *z, half, None), place)
                })
                .collect();
            page.stepped(&figures, o.shifts_mm.len() / 2, "focus");
            if o.colours.len() > 1 {
                let one = |k: usize| {
                    (
                        panels(o, 0.0, half, Some(k)),
                        format!("{} nm alone, on the sensor.", significant(o.colours[k].0, 4)),
                    )
                };
                page.stepped(&(0..o.colours.len()).map(one).collect::<Vec<_>>(), 0, "wavelength");
            }
            page.table(&spot_table(o));
        }
        let rays = self.reports.first().map_or(0, |r| r.overview.settings.rays);
        page.note(&format!(
            "rms: root mean square distance from the centroid, with its parts in x and y; radius: the farthest ray; 50 and 80 %: radii that hold so much of the light; open: part of the stop's rays that \
             arrives. All wavelengths by their weights, y upwards in the meridian of the field; the dashed circle is the Airy disc of the primary wavelength on the axis, which rays know nothing of. \
             By diffraction: the point spread of scalar waves, before any pixel, about its centroid, all wavelengths by their light; Strehl: its peak over that of the same pupils without path differences. \
             Drawn: {} rays a wavelength; figures: about {rays}, by the light they stand for. One slider moves the image plane, the other shows one wavelength alone, in its place within the spot of all.",
            self.reports.first().map_or(0, |r| r.overview.settings.drawn)
        ));
        let mut drawings = self.plot("encircled_energy");
        drawings.extend(self.plot("rms_focus"));
        page.drawings(&drawings, 440);
    }

    fn fans(&self, page: &mut Page) {
        page.section("Ray and path fans");
        let fields = self.reports.iter().map(|r| r.overview.fields.len()).max().unwrap_or(0).min(RAYS.len());
        let drawings: Vec<_> = (0..fields).flat_map(|k| [self.plot(RAYS[k]), self.plot(PATHS[k])].concat()).collect();
        page.drawings(&drawings, 380);
        page.note(
            "T: along the meridian, S: across it. Transverse errors from the primary wavelength's chief ray; path differences from the sphere about its landing \
             through the paraxial exit pupil, positive where the wavefront is ahead (Welford). Rays that an aperture stops are missing.",
        );
    }

    fn waves(&self, page: &mut Page) -> Result<()> {
        page.section("Wavefronts");
        for r in self.reports {
            self.named(page, r);
            let o = &r.overview;
            let range = waves::range(o);
            let maps: Vec<_> = o
                .fields
                .iter()
                .filter_map(|f| {
                    let (map, _) = f.map.as_ref()?;
                    Some((waves::picture(map, range), format!("{}°", significant(f.angle_deg, 4)), map.figures))
                })
                .collect();
            if maps.is_empty() {
                page.paragraph("Not made here.");
                continue;
            }
            let pictures: Vec<Picture<'_>> = maps
                .iter()
                .map(|(image, caption, figures)| Picture {
                    image,
                    caption: caption.clone(),
                    notes: vec![
                        format!("peak to valley {} waves", significant(figures.peak_to_valley, 3)),
                        format!("rms {} waves, Strehl {}", significant(figures.rms, 3), significant(figures.strehl, 3)),
                    ],
                    pixelated: true,
                })
                .collect();
            page.pictures(&pictures, 190)?;
            page.note(&format!(
                "Colours end at ±{} waves: red ahead of the reference sphere, blue behind it.",
                significant(range, 3)
            ));
            page.table(&waves::figures(o));
            if let Some(table) = waves::coefficients(o) {
                page.table(&table);
            }
        }
        page.note(
            "Primary wavelength over the real stop, y upwards, about the chief ray's landing; best: about the point that leaves the least rms. Piston is taken out. Strehl by the coherent sum over the pupil. \
             Zernike coefficients in waves rms (Noll), by light, over what apertures leave.",
        );
        Ok(())
    }

    fn field(&self, page: &mut Page) {
        page.section("Over the field");
        let names = ["field_curvature", "distortion", "lateral_colour", "longitudinal", "illumination", "chief_angle"];
        let drawings: Vec<_> = names.iter().flat_map(|n| self.plot(n)).collect();
        page.drawings(&drawings, 440);
        let grids: Vec<_> = self
            .reports
            .iter()
            .filter_map(|r| {
                let symmetric = r.lens.is_symmetric().then_some(&r.overview.curve)?;
                let svg = grid::grid(&r.lens.sensor, symmetric)?;
                Some((svg, format!("{}: a square grid on the sensor (dashed) and as the lens shows it.", r.lens.name)))
            })
            .collect();
        page.drawings(&grids, 440);
        page.note(
            "Foci of rays close to the chief ray, to 1e-8 of Coddington's equations on one sphere. Distortion against the scale of a thousandth of the field on this plane, and against the effective focal length: what the two differ by is the plane's own change of scale. \
             Relative illumination is the irradiance of white over that on the axis, edges hard (within 1e-3 of counted rays, mostly 1e-4); the open part counts the stop's area alone (to 3e-3). \
             The grid stands for a lens that is symmetric about its axis; of another none is drawn.",
        );
    }

    fn kernels(&self, page: &mut Page) -> Result<()> {
        page.section("Point spread functions");
        let mut shown = Vec::new();
        for r in self.reports {
            let Some(Atlas { kernels, depths_mm, angles_deg, outside, size }) = &r.atlas else { continue };
            let angles: Vec<String> = angles_deg.iter().map(|a| format!("{}°", significant(*a, 3))).collect();
            let rows = match &depths_mm[..] {
                [_] => String::new(),
                depths => {
                    let names: Vec<String> = depths.iter().map(|d| distance(*d)).collect();
                    format!(" (at the first distance); rows: {}", names.join(", "))
                }
            };
            let note = format!(
                "{size} × {size} pixels of {} µm, at most {} % of the light outside",
                significant(r.lens.sensor.pitch_um, 4),
                significant(100.0 * outside, 2)
            );
            for (style, scale) in [
                (Style::default(), "by its own peak".to_owned()),
                (Style { decades: Some(DECADES), ..Style::default() }, format!("{DECADES} decades below its peak")),
            ] {
                let image = picture(kernels, angles.len(), style);
                let caption = format!("{}: {}{rows}, each {scale}", r.lens.name, angles.join(", "));
                shown.push((image, caption, note.clone()));
            }
        }
        if shown.is_empty() {
            page.paragraph("Not made here.");
            return Ok(());
        }
        let pictures: Vec<Picture<'_>> = shown
            .iter()
            .map(|(image, caption, note)| Picture {
                image,
                caption: caption.clone(),
                notes: vec![note.clone()],
                pixelated: true,
            })
            .collect();
        page.pictures(&pictures, 520)?;
        page.note("Rays gathered by the sensor's pixels, without diffraction; upright as in the picture, the field's outward direction upwards; even radii to where sensor or light ends, whatever field the rest of the page is drawn for.");
        Ok(())
    }

    fn mtf(&self, page: &mut Page) {
        page.section("Modulation transfer");
        for r in self.reports {
            self.named(page, r);
            let o = &r.overview;
            let middle = o.shifts_mm.len() / 2;
            let steps = |make: &dyn Fn(usize) -> Plot| -> Vec<(String, String)> {
                let caption = |k: usize| format!("Image plane moved by {} µm.", significant(1e3 * o.shifts_mm[k], 3));
                (0..o.shifts_mm.len()).map(|k| (make(k).to_svg(), caption(k))).collect()
            };
            let waves = o.settings.waves.is_some().then(|| steps(&|k| diffraction(o, k)));
            let each: Vec<_> = waves.into_iter().chain([steps(&|k| frequency(o, Some(k)))]).collect();
            page.stepped_beside(&each, middle, "focus", 440);
        }
        let names = ["mtf_diffraction_field", "mtf_diffraction_focus", "mtf_field", "mtf_focus"];
        let made =
            |n: &&str| !n.contains("diffraction") || self.reports.iter().any(|r| r.overview.settings.waves.is_some());
        let drawings: Vec<_> = names.iter().filter(|n| made(n)).flat_map(|n| self.plot(n)).collect();
        page.drawings(&drawings, 440);
        page.note(
            "T: lines across the meridian, S: along it; all wavelengths by their weights and light. By diffraction: autocorrelation of the pupil in direction cosines, amplitude and path of real rays, edges of all \
             clear apertures (1e-4 against closed forms); where blur has more than about 100 cycles there is no value but on the sensor, at every fourth frequency, up to about 300. Geometric: modulus of the mean of exp(−2πi f·p) over rays.",
        );
    }

    fn measured(&self, page: &mut Page) -> Result<()> {
        if self.reports.iter().all(|r| r.measured.is_none()) {
            return Ok(());
        }
        page.section("Measured MTF");
        for r in self.reports {
            let Some(measured) = &r.measured else { continue };
            self.named(page, r);
            let plots = measured.plots();
            let drawings: Vec<_> = plots.iter().map(|(_, plot)| (plot.to_svg(), String::new())).collect();
            page.drawings(&drawings, 440);
            page.table(&measured.table());
            let mut shown = Vec::new();
            for place in &measured.places {
                let pictures = place.edges.iter().filter_map(|e| e.pictures.as_ref()).flatten();
                for (image, of) in pictures.zip(["T, capture", "T, reconstruction", "S, capture", "S, reconstruction"])
                {
                    shown.push((image, format!("{} mm, {of}", significant(place.height_mm, 3))));
                }
            }
            let pictures: Vec<Picture<'_>> = shown
                .into_iter()
                .map(|(image, caption)| Picture { image, caption, notes: Vec::new(), pixelated: true })
                .collect();
            if !pictures.is_empty() {
                page.pictures(&pictures, 150)?;
            }
            let by = if measured.by.is_empty() { String::new() } else { format!(" ({})", measured.by) };
            let worst = measured.worst().map_or("no edge".to_owned(), |w| significant(w, 2));
            page.note(&format!(
                "Slanted edges (e-SFR, {TILT_DEG}° off the meridian and off its perpendicular) at the middle of patches on the way to the frame's farthest corner. Capture: green pixels of the reference \
                 renderer's mosaic over the relative illumination, {} rays a pixel, without noise; reconstruction: green of what the network makes of the capture with noise{by}. Design: mean of exp(−2πi f·p) over rays along the measured \
                 normal in green light, times the MTF of a square pixel; no diffraction in either. Largest difference of capture and design up to half a cycle a pixel: {worst}; what the \
                 captures' rays leave of it is the uncertainty in the JSON. A network may sharpen edges more than fine texture.",
                measured.settings.rays,
            ));
        }
        Ok(())
    }

    fn health(&self, page: &mut Page) {
        page.section("Numerical check");
        for r in self.reports {
            self.named(page, r);
            page.table(&r.check.1);
        }
    }

    fn accuracy(&self, page: &mut Page) {
        page.section("Accuracy and time");
        for r in self.reports {
            self.named(page, r);
            let mut table = Table::new(["what", "value", "unit", "change by sampling"]);
            for (name, unit, value, change) in r.sampled() {
                table.row([name, significant(value, 5), unit.to_owned(), significant(change, 2)]);
            }
            page.table(&table);
            let mut table = Table::new(["part", "seconds"]);
            for (part, seconds) in &r.seconds {
                table.row([(*part).to_owned(), format!("{seconds:.3}")]);
            }
            page.table(&table);
        }
        page.note("Rays are exact (1e-9 mm against other programs): what is left is how many there are. Change by sampling: from a quarter of the rays, by diffraction to 1.4 times as many points each way, the largest of all frequencies.");
    }
}
