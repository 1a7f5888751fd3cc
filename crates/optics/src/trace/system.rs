//! A lens at one wavelength: what a ray meets, image surface included.

use glam::{DVec2, DVec3};

use crate::lens::pose::{Motion, placed, placed_vjp};
use crate::lens::{LensGradient, Prescription, Shape, paraxial};

/// One surface as a ray meets it.
#[derive(Clone, Debug, PartialEq)]
pub struct TraceSurface {
    /// Form.
    pub shape: Shape,
    /// Axial distance from the previous vertex, mm (0 for the first).
    pub distance: f64,
    /// Index before the surface.
    pub index_before: f64,
    /// Index behind it.
    pub index_after: f64,
    /// Clear semi-diameter, mm (infinite for the image surface).
    pub semi_diameter: f64,
    /// Where the surface stands relative to its nominal vertex frame.
    pub motion: Option<Motion>,
    /// Whether anything beyond the conic is present (kept so that the inner loop does not search).
    pub aspheric: bool,
    /// Radius within which the first root is looked for, mm; see [`super::first_root`].
    pub domain: f64,
    /// Upper bound of the slope `|∇h|` within [`Self::domain`].
    pub steepest: f64,
    /// Of an ideal lens: the pair of planes between which its paths are equal, 1/mm: half of what the reduced vergence of the object before it exceeds that of its image by.
    pub conjugate: f64,
}

/// The surface is taken to go on to this multiple of its clear semi-diameter.
const DOMAIN: f64 = 1.1;

impl TraceSurface {
    /// A surface in its nominal place, `distance` behind the previous vertex, between two indices.
    pub fn new(shape: Shape, distance: f64, indices: [f64; 2], semi_diameter: f64) -> Self {
        let domain = (DOMAIN * semi_diameter).min(shape.reach());
        Self {
            aspheric: shape.is_aspheric(),
            steepest: if shape.is_aspheric() { shape.steepest(domain) } else { f64::INFINITY },
            shape,
            distance,
            index_before: indices[0],
            index_after: indices[1],
            semi_diameter,
            motion: None,
            domain,
            conjugate: 0.0,
        }
    }

    /// Sag and slopes at `(x, y)`, in its own frame; none beyond its reach.
    fn on(&self, at: DVec2) -> Option<(f64, DVec2)> {
        if self.shape.curvature == 0.0 && !self.aspheric {
            return Some((0.0, DVec2::ZERO));
        }
        self.shape.at(at.x, at.y).map(|local| (local.h, DVec2::from(local.slope)))
    }

    /// The point at `(x, y)`, mm in its own frame; not a number beyond its reach.
    pub(crate) fn point(&self, at: DVec2) -> DVec3 {
        at.extend(self.on(at).map_or(f64::NAN, |(h, _)| h))
    }

    /// Its slopes `∂z/∂(x, y)` there.
    pub(crate) fn slope(&self, at: DVec2) -> DVec2 {
        self.on(at).map_or(DVec2::NAN, |(_, slope)| slope)
    }

    /// The same surface met from the other side, `distance` behind the previous vertex.
    #[must_use]
    pub(super) fn reversed(&self, distance: f64) -> Self {
        Self {
            shape: self.shape.reversed(),
            distance,
            index_before: self.index_after,
            index_after: self.index_before,
            motion: self.motion.map(|m| m.mirrored()),
            conjugate: -self.conjugate,
            ..*self
        }
    }
}

/// `n N` of a ray in a medium of index `n` whose optical direction cosines along a surface of these slopes are `q = n((L, M) + N ∇z)`: of `|q − nN ∇z|² + (nN)² = n²`; not a
/// number where there is no such ray.
pub(crate) fn axial_cosine(q: DVec2, slope: DVec2, index: f64) -> f64 {
    let under = index * index - q.length_squared();
    if slope == DVec2::ZERO {
        return under.sqrt();
    }
    let (steep, along) = (1.0 + slope.length_squared(), q.dot(slope));
    (along + (along * along + steep * under).sqrt()) / steep
}

/// All surfaces of a lens at one wavelength; the image surface is the last.
#[derive(Clone, Debug, PartialEq)]
pub struct System {
    /// Wavelength, nm.
    pub wavelength_nm: f64,
    /// Surfaces, image surface last.
    pub surfaces: Vec<TraceSurface>,
    /// The stop's surface.
    pub stop: usize,
    /// Semi-diameter of the stop, mm.
    pub stop_semi_diameter: f64,
}

impl System {
    /// `lens` at `nm`.
    ///
    /// ```
    /// use isoplanat_optics::lens::builtin;
    /// use isoplanat_optics::trace::System;
    ///
    /// let lens = builtin::lens("cooke_triplet")?;
    /// let system = System::new(&lens, 587.6);
    /// // Six faces, and the image plane behind them.
    /// assert_eq!(system.image(), 6);
    /// # Ok::<(), isoplanat_base::error::Error>(())
    /// ```
    pub fn new(lens: &Prescription, nm: f64) -> Self {
        let n = lens.indices(nm);
        let stop_semi_diameter = paraxial::stop_semi_diameter(lens);
        let mut surfaces = Vec::with_capacity(lens.surfaces.len() + 1);
        let mut distance = 0.0;
        let vertices = lens.vertices();
        let conjugates = paraxial::conjugates(lens, nm);
        for (i, s) in lens.surfaces.iter().enumerate() {
            let semi_diameter = if i == lens.stop { stop_semi_diameter } else { s.semi_diameter };
            let mut surface = TraceSurface::new(s.shape.clone(), distance, [n[i], n[i + 1]], semi_diameter);
            surface.motion = placed(i, s.pose.as_ref(), &lens.elements, &vertices);
            surface.conjugate = conjugates.get(i).copied().unwrap_or(0.0);
            surfaces.push(surface);
            distance = s.thickness;
        }
        let last = n[n.len() - 1];
        surfaces.push(TraceSurface::new(lens.image.shape(), distance, [last, last], f64::INFINITY));
        Self { wavelength_nm: nm, surfaces, stop: lens.stop, stop_semi_diameter }
    }

    /// The same lens met from the sensor's side: the first surface is the image's, the last the former
    /// first vertex.
    #[must_use]
    pub fn reversed(&self) -> Self {
        let count = self.surfaces.len();
        let mut surfaces = Vec::with_capacity(count);
        let mut distance = 0.0;
        for s in self.surfaces.iter().rev() {
            surfaces.push(s.reversed(distance));
            distance = s.distance;
        }
        Self { surfaces, stop: count - 1 - self.stop, ..*self }
    }

    /// Index of the image surface in [`Self::surfaces`].
    pub fn image(&self) -> usize {
        self.surfaces.len() - 1
    }

    /// What rays land on.
    pub(crate) fn image_surface(&self) -> &TraceSurface {
        &self.surfaces[self.image()]
    }
}

/// Cotangents of a [`System`].
#[derive(Clone, Debug, PartialEq)]
pub struct SystemGradient {
    /// Shapes of the surfaces (the image surface's included, which no design moves).
    pub shapes: Vec<Shape>,
    /// Distances to the previous vertex.
    pub distances: Vec<f64>,
    /// Index of space `i`: entry 0 before the first surface, entry `i + 1` behind surface `i`.
    pub indices: Vec<f64>,
    /// Clear semi-diameters.
    pub semi_diameters: Vec<f64>,
    /// Semi-diameter of the stop.
    pub stop_semi_diameter: f64,
    /// Places of the surfaces that state a pose.
    pub motions: Vec<Motion>,
    /// Pairs of planes of ideal lenses.
    pub conjugates: Vec<f64>,
}

impl SystemGradient {
    /// All zero, in the form of `system`.
    pub fn zeros(system: &System) -> Self {
        let count = system.surfaces.len();
        Self {
            shapes: system.surfaces.iter().map(|s| s.shape.zeros_like()).collect(),
            distances: vec![0.0; count],
            indices: vec![0.0; count + 1],
            semi_diameters: vec![0.0; count],
            stop_semi_diameter: 0.0,
            motions: vec![Motion::ZERO; count],
            conjugates: vec![0.0; count],
        }
    }

    /// Cotangents of a system from those of its [`System::reversed`], of which they are linear maps; without poses.
    ///
    /// # Panics
    /// If a surface's pose has a cotangent: derivatives by tilts are not taken from the sensor.
    #[must_use]
    pub(crate) fn reversed(&self) -> Self {
        assert!(self.motions.iter().all(|m| *m == Motion::ZERO), "derivatives by tilts are not taken from the sensor");
        let flipped = |list: &[f64]| list.iter().rev().copied().collect::<Vec<f64>>();
        // The distance before a surface was the one behind it; the first has none.
        let mut distances = flipped(&self.distances);
        distances.rotate_right(1);
        Self {
            shapes: self.shapes.iter().rev().map(Shape::reversed).collect(),
            distances,
            indices: flipped(&self.indices),
            semi_diameters: flipped(&self.semi_diameters),
            stop_semi_diameter: self.stop_semi_diameter,
            motions: self.motions.clone(),
            conjugates: self.conjugates.iter().rev().map(|c| -c).collect(),
        }
    }

    /// Adds the cotangents `other` of the same system.
    pub fn add(&mut self, other: &Self) {
        let add = |a: &mut [f64], b: &[f64]| a.iter_mut().zip(b).for_each(|(x, y)| *x += y);
        self.shapes.iter_mut().zip(&other.shapes).for_each(|(a, b)| a.add(b));
        add(&mut self.distances, &other.distances);
        add(&mut self.indices, &other.indices);
        add(&mut self.semi_diameters, &other.semi_diameters);
        add(&mut self.conjugates, &other.conjugates);
        self.stop_semi_diameter += other.stop_semi_diameter;
        for (a, b) in self.motions.iter_mut().zip(&other.motions) {
            a.rotation += b.rotation;
            a.shift += b.shift;
        }
    }

    /// Adds these cotangents to `gradient` of `lens`, glasses and stop size included.
    pub fn add_to(&self, lens: &Prescription, wavelength_nm: f64, gradient: &mut LensGradient) {
        for (i, g) in gradient.surfaces.iter_mut().enumerate() {
            g.shape.add(&self.shapes[i]);
            g.thickness += self.distances[i + 1];
            if i != lens.stop {
                g.semi_diameter += self.semi_diameters[i];
            }
        }
        self.add_poses_to(lens, gradient);
        let image = lens.surfaces.len();
        let mut indices = self.indices[..=image].to_vec();
        // The image plane stands in the last space.
        indices[image] += self.indices[image + 1];
        paraxial::conjugates_vjp(lens, wavelength_nm, &self.conjugates, gradient, &mut indices);
        gradient.add_indices(lens, wavelength_nm, &indices);
        let stop_bar = self.stop_semi_diameter + self.semi_diameters[lens.stop];
        if stop_bar != 0.0 {
            paraxial::first_order_vjp(lens, lens.wavelengths.primary_nm, 0.0, stop_bar, gradient);
        }
    }

    fn add_poses_to(&self, lens: &Prescription, gradient: &mut LensGradient) {
        let vertices = lens.vertices();
        let mut vertex_bar = vec![0.0; vertices.len()];
        for (i, s) in lens.surfaces.iter().enumerate() {
            if self.motions[i] == Motion::ZERO {
                continue;
            }
            placed_vjp(
                i,
                s.pose.as_ref(),
                &lens.elements,
                &vertices,
                &self.motions[i],
                gradient.surfaces[i].pose.as_mut(),
                &mut gradient.elements,
                &mut vertex_bar,
            );
        }
        // A vertex lies behind all thicknesses before it.
        let mut behind = 0.0;
        for i in (1..vertices.len()).rev() {
            behind += vertex_bar[i];
            gradient.surfaces[i - 1].thickness += behind;
        }
    }
}
