//! House fronts in elevation: walls of brick, plaster or stone, windows, doors, bands, balconies and roofs, in metres.

use fastrand::Rng;

use super::canvas::{Rgb, mix, scaled};
use super::noise_tile::NoiseTile;
use super::palette::{between, normal, of_luminance};

/// The sun: which side it stands on (sign of x), its elevation's tangent across the street, and whether it shines.
pub(super) struct Sun {
    pub(super) side: f32,
    pub(super) slope: f32,
    pub(super) hard: bool,
}

/// A row of houses along a street.
pub(super) struct Row {
    houses: Vec<House>,
}

struct House {
    start: f32,
    width: f32,
    height: f32,
    roof: f32,
    /// Pointed towards the street rather than sloping away from it.
    gable: bool,
    brick: bool,
    wall: Rgb,
    trim: Rgb,
    tiles: Rgb,
    shutters: Option<Rgb>,
    storey: f32,
    bay: f32,
    window: [f32; 2],
    arched: bool,
    balconies: bool,
    chimney: f32,
    seed: u32,
}

/// A number in `[0, 1)` for a window or brick, the same at every look.
fn chance(seed: u32, i: i32, j: i32) -> f32 {
    let mut h = seed ^ (i as u32).wrapping_mul(0x9e37_79b1) ^ (j as u32).wrapping_mul(0x85eb_ca77);
    h = (h ^ (h >> 15)).wrapping_mul(0x2c1b_3c6d);
    h = (h ^ (h >> 12)).wrapping_mul(0x297a_2d39);
    (h ^ (h >> 15)) as f32 / 4_294_967_296.0
}

impl House {
    fn new(rng: &mut Rng, start: f32) -> Self {
        let storey = between(rng, 2.8, 3.6);
        let width = between(rng, 5.0, 14.0);
        let bays = (width / between(rng, 1.7, 2.8)).floor().max(2.0);
        let brick = rng.u8(..5) < 3;
        let wall = if brick {
            let red = between(rng, 0.14, 0.34);
            [red, red * between(rng, 0.38, 0.72), red * between(rng, 0.25, 0.5)]
        } else {
            let light = between(rng, 0.25, 0.75);
            let tint = of_luminance(rng, light);
            mix([light; 3], tint, 0.6)
        };
        let bay = width / bays;
        let pale = between(rng, 0.4, 0.8);
        let dark = between(rng, 0.03, 0.12);
        let red = between(rng, 0.1, 0.25);
        Self {
            start,
            width,
            height: storey * (2.0 + f32::from(rng.u8(..4))) + 0.5,
            roof: between(rng, 1.0, 3.5),
            gable: rng.u8(..4) == 0,
            brick,
            wall,
            trim: [pale, 0.97 * pale, 0.9 * pale],
            tiles: if rng.bool() { [red, 0.45 * red, 0.3 * red] } else { [dark, dark, 1.15 * dark] },
            shutters: (rng.u8(..4) == 0).then(|| of_luminance(rng, 0.12)),
            storey,
            bay,
            window: [bay * between(rng, 0.35, 0.6), storey * between(rng, 0.45, 0.65)],
            arched: rng.u8(..3) == 0,
            balconies: rng.u8(..4) == 0,
            chimney: between(rng, 0.1, 0.9) * width,
            seed: rng.u32(..),
        }
    }

    /// Roof line above a position.
    fn top(&self, u: f32) -> f32 {
        let slope = if self.gable { 1.0 - (2.0 * u / self.width - 1.0).abs() } else { 1.0 };
        let chimney = if (u - self.chimney).abs() < 0.45 { self.roof + 1.0 } else { 0.0 };
        self.height + (self.roof * slope).max(chimney)
    }

    fn look(&self, u: f32, v: f32, footprint: f32, light: f32, tile: &NoiseTile) -> Rgb {
        let shade = 0.45 + 0.95 * light;
        let stain = 1.0 + 0.1 * tile.at(6.0 * u, 2.0 * v + 100.0) - 0.25 * (1.0 - 0.8 * v).clamp(0.0, 1.0);
        if v > self.height {
            return scaled(self.roof_look(u, v, footprint, tile), shade);
        }
        // Gutter and cornice.
        if v > self.height - 0.45 {
            let step = ((self.height - v) / 0.15).floor();
            return scaled(self.trim, shade * (1.0 - 0.25 * step));
        }
        let (floor, bay) = ((v / self.storey).floor(), (u / self.bay).floor());
        let (fu, fv) = (u - (bay + 0.5) * self.bay, v - floor * self.storey);
        let ground = floor < 0.5;
        // One bay of the ground floor is the door.
        let door = ground && (bay as i32) == (self.width / self.bay * chance(self.seed, 7, 9)) as i32;
        let [w, h] = self.window;
        let (low, high) = if door { (0.0, 2.3) } else { (0.28 * self.storey, 0.28 * self.storey + h) };
        let rise = if self.arched { 0.25 * w * (1.0 - (2.0 * fu / w).powi(2)).max(-1.0) } else { 0.0 };
        let inside = fu.abs() < 0.5 * w && fv > low && fv < high + rise;
        // Iron in front of the lower half of a window.
        if self.balconies && !ground && fu.abs() < 0.5 * w + 0.25 && fv > low - 0.1 && fv < low + 0.95 {
            let bar = fu.rem_euclid(0.12) < 0.025 || fv > low + 0.9 || (fv < low);
            if bar {
                return scaled([0.03; 3], shade);
            }
        }
        if inside {
            if door {
                let panel = (fu.abs() - 0.25 * w).abs() > 0.18 * w || (fv - 1.2).abs() > 0.85 || (fv - 1.2).abs() < 0.1;
                let paint: Rgb = std::array::from_fn(|k| 0.02 + 0.28 * chance(self.seed, k as i32, 2).powi(2));
                return scaled(paint, shade * if panel { 1.0 } else { 0.7 });
            }
            return self.glass([fu, fv - low], rise, [bay as i32, floor as i32], shade, tile);
        }
        // Sill, lintel, band between the storeys, shutters.
        if fu.abs() < 0.5 * w + 0.12 && fv > low - 0.14 && fv <= low {
            return scaled(self.trim, shade * 1.1);
        }
        if fu.abs() < 0.5 * w + 0.12 && fv >= high + rise && fv < high + rise + 0.2 {
            return scaled(self.trim, shade * 0.85);
        }
        if let Some(colour) = self.shutters {
            let off = fu.abs() - 0.5 * w;
            if off > 0.03 && off < 0.42 * w && fv > low && fv < high {
                let slat = 1.0 + 0.35 * (0.03 / footprint.max(0.01)).min(1.0) * ((fv * 62.0).sin());
                return scaled(colour, shade * slat);
            }
        }
        if ground && fv > self.storey - 0.22 {
            return scaled(self.trim, shade * if fv > self.storey - 0.06 { 1.1 } else { 0.8 });
        }
        // A shadow under sill and cornice.
        let under = if v > self.height - 0.8 { 0.7 } else { 1.0 };
        scaled(self.bricks(u, v, footprint, tile), shade * stain * under)
    }

    /// The bare wall: bricks in stretcher bond, or plaster; mortar fades where a pixel covers several bricks.
    fn bricks(&self, u: f32, v: f32, footprint: f32, tile: &NoiseTile) -> Rgb {
        let sharp = (0.03 / footprint.max(1e-3)).min(1.0);
        if !self.brick {
            return scaled(self.wall, 1.0 + 0.08 * sharp * tile.at(60.0 * u, 60.0 * v));
        }
        let course = (v / 0.075).floor();
        let along = u / 0.24 + 0.5 * course.rem_euclid(2.0);
        let (x, y) = (along.rem_euclid(1.0) * 0.24, v - course * 0.075);
        let mortar = x < 0.012 || y < 0.012;
        let burnt = 0.7 + 0.6 * chance(self.seed, along.floor() as i32, course as i32);
        let brick = scaled(self.wall, 1.0 + sharp * (burnt - 1.0));
        let joint = [0.38, 0.36, 0.33];
        // Mortar is a fifth of the wall.
        let average = mix(self.wall, joint, 0.2);
        mix(average, if mortar { joint } else { brick }, sharp)
    }

    /// A window pane with frame and glazing bars; the sky or a curtain in it.
    fn glass(&self, [u, v]: [f32; 2], rise: f32, [bay, floor]: [i32; 2], shade: f32, tile: &NoiseTile) -> Rgb {
        let [w, h] = self.window;
        let frame = 0.5 * w - u.abs() < 0.07 || v < 0.07 || h + rise - v < 0.07;
        let bars = u.abs() < 0.025 || (v - 0.62 * h).abs() < 0.025;
        if frame || bars {
            return scaled(self.trim, 1.15 * shade);
        }
        let kind = chance(self.seed, bay, floor);
        // The upper part of a recess lies in the lintel's shadow.
        let recess = if h + rise - v < 0.22 { 0.5 } else { 1.0 };
        let room = [0.03, 0.035, 0.04].map(|c| c + 0.05 * kind);
        let mirror = (0.5 + 0.4 * tile.at(4.0 * u + 50.0 * kind, 3.0 * v)).clamp(0.0, 1.0);
        let pane = mix(room, [0.35, 0.42, 0.5], 0.55 * mirror * (v / h));
        let curtain = kind > 0.6 && (u.abs() > 0.22 * w || kind > 0.85);
        let folds = 0.8 + 0.2 * (u * 40.0).sin();
        scaled(if curtain { mix(pane, [0.55, 0.53, 0.48], 0.6 * folds) } else { pane }, recess * (0.7 + 0.3 * shade))
    }

    /// Courses of tiles, chimneys.
    fn roof_look(&self, u: f32, v: f32, footprint: f32, tile: &NoiseTile) -> Rgb {
        let slope = if self.gable { 1.0 - (2.0 * u / self.width - 1.0).abs() } else { 1.0 };
        let chimney = (u - self.chimney).abs() < 0.45;
        if v > self.height + self.roof * slope || (chimney && v > self.height + 0.6 * self.roof) {
            return scaled(
                self.bricks(u, v, footprint, tile),
                if v > self.height + self.roof + 0.85 { 0.5 } else { 0.9 },
            );
        }
        if self.gable {
            return self.bricks(u, v, footprint, tile);
        }
        let sharp = (0.06 / footprint.max(1e-3)).min(1.0);
        let course = (v / 0.2).floor();
        let (x, y) = ((u / 0.25 + 0.5 * course.rem_euclid(2.0)).rem_euclid(1.0), (v / 0.2).rem_euclid(1.0));
        let relief = 1.0 + sharp * (0.35 * (x - 0.5) + 0.5 * (y - 0.5));
        let worn = 0.75 + 0.5 * chance(self.seed, (u / 0.25 + 0.5 * course) as i32, course as i32);
        scaled(self.tiles, relief * (1.0 + sharp * (worn - 1.0)))
    }
}

impl Row {
    /// Houses side by side over a length in metres.
    pub(super) fn new(rng: &mut Rng, length: f32) -> Self {
        let mut houses = Vec::new();
        let mut start = -3.0 - 5.0 * rng.f32();
        // Neighbours differ a little in height, seldom much.
        let lean = 0.3 * normal(rng);
        while start < length {
            let mut house = House::new(rng, start);
            house.height += lean;
            start += house.width;
            houses.push(house);
        }
        Self { houses }
    }

    fn house(&self, along: f32) -> &House {
        let i = self.houses.partition_point(|h| h.start <= along).max(1) - 1;
        &self.houses[i]
    }

    /// Height of the roof line at a position along the row, m.
    pub(super) fn height(&self, along: f32) -> f32 {
        let house = self.house(along);
        house.top(along - house.start)
    }

    /// What is seen at a position along the row and a height; `None` above the roofs. `light` is the sun's share.
    pub(super) fn look(&self, along: f32, v: f32, footprint: f32, light: f32, tile: &NoiseTile) -> Option<Rgb> {
        let house = self.house(along);
        let u = along - house.start;
        (v <= house.top(u)).then(|| {
            // A gap or a pipe between two houses.
            if u < 0.1 { scaled([0.06; 3], 0.5 + light) } else { house.look(u, v, footprint, light, tile) }
        })
    }
}
