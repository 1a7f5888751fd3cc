//! Numbers: which pairs there are, which files they stand in, and who makes them.

use std::ops::Range;

use isoplanat_base::math::mixed;

use super::settings::Part;

/// Lenses times distances, photographs and crops in the order of the pairs' numbers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Layout {
    /// Lenses.
    pub lenses: usize,
    /// Distances of each.
    pub distances: usize,
    /// Photographs.
    pub photos: usize,
    /// Pairs of each.
    pub crops: usize,
    /// Photographs whose pairs are written together.
    pub together: usize,
}

/// What is written together: pairs of one lens at one distance.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Unit {
    /// Its number.
    pub number: usize,
    /// Lens and distance.
    pub group: usize,
    /// Photographs.
    pub photos: Range<usize>,
}

impl Layout {
    /// Lenses at distances.
    pub(super) fn groups(&self) -> usize {
        self.lenses * self.distances
    }

    /// Lens and distance of a group.
    pub(super) fn of_group(&self, group: usize) -> (usize, usize) {
        (group / self.distances, group % self.distances)
    }

    /// Pairs.
    pub(super) fn pairs(&self) -> usize {
        self.groups() * self.photos * self.crops
    }

    /// The number of a pair.
    pub(super) fn number(&self, group: usize, photo: usize, crop: usize) -> usize {
        (group * self.photos + photo) * self.crops + crop
    }

    fn units_of_group(&self) -> usize {
        self.photos.div_ceil(self.together)
    }

    /// How many units there are.
    pub(super) fn units(&self) -> usize {
        self.groups() * self.units_of_group()
    }

    /// A unit by its number.
    pub(super) fn unit(&self, number: usize) -> Unit {
        let each = self.units_of_group();
        let first = number % each * self.together;
        Unit { number, group: number / each, photos: first..self.photos.min(first + self.together) }
    }

    /// The units of a part: neighbours, so that few lenses are planned.
    pub(super) fn part(&self, Part { index, of }: Part) -> Range<usize> {
        let end = |k: usize| (self.units() as u128 * k as u128 / of as u128) as usize;
        end(index)..end(index + 1)
    }
}

/// Which of `count` are drawn: a share of them, those that the seed ranks first.
pub(super) fn drawn(seed: u64, count: usize, share: f64) -> Vec<bool> {
    let most = (share * count as f64).round() as usize;
    let rank = |k: &usize| mixed(seed ^ 0x6a75_6467, *k as u64);
    let mut order: Vec<usize> = (0..count).collect();
    order.sort_by_cached_key(rank);
    let mut drawn = vec![false; count];
    order[..most.min(count)].iter().for_each(|k| drawn[*k] = true);
    drawn
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_stands_in_one_unit_of_one_part() {
        for (photos, together, of) in [(7, 3, 1), (7, 3, 4), (1, 5, 3), (24, 1, 5), (3, 2, 40)] {
            let layout = Layout { lenses: 2, distances: 3, photos, crops: 4, together };
            let units = (0..of).flat_map(|index| layout.part(Part { index, of })).map(|u| layout.unit(u));
            let numbers: Vec<usize> = units
                .flat_map(|u| u.photos.clone().flat_map(move |p| (0..4).map(move |c| layout.number(u.group, p, c))))
                .collect();
            assert_eq!(numbers, (0..layout.pairs()).collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_share_is_drawn_exactly() {
        for (count, share, most) in [(200, 0.1, 20), (7, 1.0, 7), (7, 0.0, 0), (3, 0.5, 2)] {
            let picked = drawn(5, count, share);
            assert_eq!(picked.iter().filter(|d| **d).count(), most);
        }
        assert_ne!(drawn(5, 200, 0.1), drawn(6, 200, 0.1));
    }
}
