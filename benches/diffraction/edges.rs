//! Slanted edges in pictures against the kernel's own MTF at their place, over lenses, stops, places and directions.

use isoplanat::imaging::render::{Diffraction, Request, Settings};

use super::edge::{Finest, Place};

/// Lenses and stops.
const CASES: [(&str, Option<f64>); 8] = [
    ("double_gauss", Some(2.8)),
    ("double_gauss", Some(8.0)),
    ("double_gauss", Some(16.0)),
    ("phone", None),
    ("phone", Some(5.6)),
    ("cooke_triplet", Some(8.0)),
    ("cooke_triplet", Some(16.0)),
    ("cooke_triplet", Some(2.8)),
];
/// Places from the axis to the end of the field.
const PLACES: [(&str, f64); 3] = [("axis", 0.0), ("half way", 0.5), ("corner", 1.0)];
const FINEST: Finest = Finest { wavelengths: 16, size: 101 };

/// Every picture by the finest settings, and as planned for 45 dB.
pub(crate) fn print() {
    println!(
        "| lens | f-number | place | edge | kernels | MTF at ½ Nyquist, Nyquist | finest: off, at cy/px | analysis alone | picture alone | 45 dB: off | its samples, wavelengths |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for (name, f_number) in CASES {
        for (place, share) in PLACES {
            let Some(at) = Place::new(name, f_number, share) else { continue };
            for (edge, tangential) in [("tangential", true), ("sagittal", false)] {
                for (kernels, diffraction) in [("waves", Diffraction::On), ("rays", Diffraction::Off)] {
                    let fine = Settings { diffraction: diffraction.stated(), ..Settings::FINE };
                    let finest = at.edge((tangential, diffraction), Request::Settings(fine), FINEST, true);
                    let planned = at.edge((tangential, diffraction), Request::Psnr(45.0), FINEST, false);
                    let f = f_number.map_or_else(|| "own".to_owned(), |n| n.to_string());
                    let finest = match &finest {
                        Ok(e) => {
                            let ((off, at), own) = (e.off(), &e.own);
                            format!(
                                "{:.3}, {:.3} | {off:.4}, {at:.2} | {:.4} | {:.4}",
                                own[25],
                                own[50],
                                e.analysis(),
                                e.picture()
                            )
                        }
                        Err(why) => format!("| {why} | |"),
                    };
                    let planned = match &planned {
                        Ok(e) => format!("{:.4} | {}, {}", e.off().0, e.samples, e.wavelengths),
                        Err(why) => format!("{why} |"),
                    };
                    println!("| {name} | {f} | {place} | {edge} | {kernels} | {finest} | {planned} |");
                }
            }
        }
    }
}
