//! A lens made larger or smaller.

use super::freeform::{Xy, Zernike};
use super::{Aperture, Field, Prescription, Shape};

impl Prescription {
    /// Makes all lengths `factor` times as large, the object's distance among them; the sensor's raster, angles and media stay. Shapes stay what they
    /// are: sag·factor at radius·factor.
    pub fn enlarge(&mut self, factor: f64) {
        for s in &mut self.surfaces {
            let Shape { curvature, conic: _, asphere, odd: odd_terms, zernike, xy, ideal } = &mut s.shape;
            *curvature /= factor;
            ideal.iter_mut().for_each(|f| *f *= factor);
            // a_n in mm^(1−n): n = 2, 4, … and 3, 5, …
            let square = factor * factor;
            let (mut even, mut odd) = (1.0 / factor, 1.0 / square);
            for a in asphere {
                *a *= even;
                even /= square;
            }
            for a in odd_terms {
                *a *= odd;
                odd /= square;
            }
            // Lengths over a radius that grows with them.
            if let Some(z) = zernike {
                let terms = z.terms().iter().map(|t| t * factor).collect();
                *z = Zernike::new(z.radius() * factor, terms);
            }
            if let Some(xy) = xy {
                let terms = xy.orders().iter().zip(xy.terms()).map(|((i, j), t)| (*i, *j, t * factor));
                let terms: Vec<_> = terms.collect();
                *xy = Xy::new(xy.radius() * factor, &terms);
            }
            s.thickness *= factor;
            s.semi_diameter *= factor;
            if let Some(pose) = &mut s.pose {
                pose.decentre.iter_mut().for_each(|d| *d *= factor);
            }
        }
        for e in &mut self.elements {
            e.pose.decentre.iter_mut().for_each(|d| *d *= factor);
            e.pivot *= factor;
        }
        self.object_vergence /= factor;
        self.image.curvature /= factor;
        match &mut self.aperture {
            Aperture::EntrancePupilDiameter(d) | Aperture::StopSemiDiameter(d) => *d *= factor,
            Aperture::FNumber(_) | Aperture::ObjectNa(_) => {}
        }
        if let Field::ObjectHeight(height) = &mut self.field {
            *height *= factor;
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::lens::{Lens, Surface, builtin, paraxial};
    use isoplanat_base::testing::assert_rel;

    /// Every first-order length of every shipped lens grows by the factor, and there and back is the lens again.
    #[test]
    fn lengths_grow_and_ratios_stay() {
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect("shipped");
            let large = lens.changed(|l| l.enlarge(2.5)).expect("a lens");
            let first = |l: &Lens| paraxial::first_order(l, l.wavelengths.primary_nm);
            let (a, b) = (first(&lens), first(&large));
            assert_rel(b.effective_focal_length, 2.5 * a.effective_focal_length, 1e-12, 0.0, name);
            assert_rel(b.entrance_pupil_diameter, 2.5 * a.entrance_pupil_diameter, 1e-12, 0.0, name);
            assert_rel(b.paraxial_image_distance, 2.5 * a.paraxial_image_distance, 1e-11, 0.0, name);
            assert_rel(b.f_number, a.f_number, 1e-12, 0.0, name);
        }
    }

    /// Every term that a form can have: sag·factor at radius·factor, off the meridian.
    #[test]
    fn every_term_grows() {
        for lens in crate::lens::test_lenses::every_kind().all() {
            let large = crate::lens::unchecked(&lens, |l| l.enlarge(2.5));
            for (s, t) in lens.surfaces.iter().zip(&large.surfaces) {
                let h = 0.5 * s.semi_diameter;
                let sag = |s: &Surface, k: f64| s.shape.at(k * h, -0.6 * k * h).map_or(f64::NAN, |l| l.h);
                assert_rel(sag(t, 2.5), 2.5 * sag(s, 1.0), 1e-11, 1e-14, &lens.name);
                let [a, b] = [s, t].map(|s| s.pose.map_or([0.0; 2], |p| p.decentre));
                assert_eq!(a.map(|d| 2.5 * d), b);
            }
            let [a, b] = [&lens, &large].map(|l| l.elements.iter().map(|e| e.pivot).sum::<f64>());
            assert_rel(b, 2.5 * a, 1e-12, 1e-15, "pivots");
        }
    }

    /// Shipped lenses keep their shapes.
    #[test]
    fn shapes_stay() {
        for (name, _) in builtin::LENSES {
            let lens = builtin::lens(name).expect("shipped");
            let large = lens.changed(|l| l.enlarge(2.5)).expect("a lens");
            for (s, t) in lens.surfaces.iter().zip(&large.surfaces) {
                let h = 0.7 * s.semi_diameter;
                let sag = |s: &Surface, h: f64| s.shape.at(0.0, h).map_or(f64::NAN, |l| l.h);
                assert_rel(sag(t, 2.5 * h), 2.5 * sag(s, h), 1e-11, 1e-14, name);
            }
        }
    }
}
