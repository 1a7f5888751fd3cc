//! A point of the sensor: what every kernel and every number of the image belongs to.

/// A point of the sensor, in mm along columns and rows from where the axis meets it.
///
/// A lens with rotational symmetry is asked at a point's [radius](Self::radius_mm) and turned to its [direction](Self::outward); on the axis, where a point has no
/// direction, that of the line it was taken from.
///
/// ```
/// use isoplanat_optics::psf::SensorPoint;
///
/// let point = SensorPoint::at([3.0, -4.0]);
/// assert_eq!((point.radius_mm(), point.outward()), (5.0, [0.6, -0.8]));
/// assert_eq!(SensorPoint::along([0.0, -1.0], 5.0).mm(), [0.0, -5.0]);
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensorPoint {
    mm: [f64; 2],
    radius_mm: f64,
    /// Unit vector.
    outward: [f64; 2],
}

impl SensorPoint {
    /// Where the axis meets the sensor.
    pub const AXIS: Self = Self { mm: [0.0; 2], radius_mm: 0.0, outward: [1.0, 0.0] };

    /// The point `[column, row]` mm from the axis.
    pub fn at(mm: [f64; 2]) -> Self {
        let length = mm[0].hypot(mm[1]);
        let outward = if length > 0.0 { mm.map(|v| v / length) } else { [1.0, 0.0] };
        Self { mm, radius_mm: length, outward }
    }

    /// The point `radius_mm` from the axis along the unit vector `outward`, `(column, row)`.
    pub fn along(outward: [f64; 2], radius_mm: f64) -> Self {
        Self { mm: outward.map(|v| v * radius_mm), radius_mm, outward }
    }

    /// Columns and rows, mm from the axis.
    pub fn mm(self) -> [f64; 2] {
        self.mm
    }

    /// Distance from the axis, mm.
    pub fn radius_mm(self) -> f64 {
        self.radius_mm
    }

    /// The direction in which the distance from the axis grows, a unit vector `(column, row)`.
    pub fn outward(self) -> [f64; 2] {
        self.outward
    }
}
