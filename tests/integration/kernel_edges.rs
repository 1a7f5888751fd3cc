//! Slanted edges in pictures against the MTF of the kernel at their place. `cargo bench --bench diffraction -- edges` has the table over lenses, stops and places.

#[path = "../../benches/diffraction/edge.rs"]
mod edge;

use isoplanat::imaging::render::{Diffraction, Request, Settings};

use edge::{Finest, Place};

const FINEST: Finest = Finest { wavelengths: 16, size: 101 };

/// The curves agree to 0.005 from 0 to half a cycle a pixel: half way and in the corner, both directions, by diffraction and by rays. Of the phone lens, whose kernel is far wider than
/// a pixel there, the analysis alone errs by 0.017 in an edge that is made of the kernel: picture and that edge agree through it.
#[test]
fn edges_in_pictures_have_the_mtf_of_their_kernel() {
    for (name, f_number, share, tangential, how) in [
        ("double_gauss", Some(16.0), 1.0, true, Diffraction::On),
        ("double_gauss", Some(8.0), 0.5, false, Diffraction::Off),
        ("phone", None, 0.5, true, Diffraction::On),
    ] {
        let place = Place::new(name, f_number, share).expect("it opens so far");
        let settings = Settings { samples: 2, diffraction: how.stated(), ..Settings::FINE };
        let found = place.edge((tangential, how), Request::Settings(settings), FINEST, true).expect("an edge");
        let (off, at) = found.off();
        eprintln!(
            "{name} {f_number:?} at {:.2} mm: {off:.4} at {at} cycles a pixel; {} samples, {} wavelengths; MTF at half Nyquist {:.3}, at Nyquist {:.3}; the analysis alone {:.4}, the picture alone {:.4}",
            place.radius_mm,
            found.samples,
            found.wavelengths,
            found.own[25],
            found.own[50],
            found.analysis(),
            found.picture()
        );
        assert!(found.picture() < 5e-3, "{name} {f_number:?}: the picture alone {}", found.picture());
        assert!(off < 5e-3 || name == "phone", "{name} {f_number:?}: {off} at {at} cycles a pixel");
    }
}
