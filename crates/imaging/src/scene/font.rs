//! A small stroke font drawn for this crate: polylines on a grid 4 wide, baseline at 2, capitals to 8, descenders to 0.

/// Strokes of a character: polylines separated by spaces, each point two digits, x then y.
fn strokes(character: char) -> &'static str {
    match character {
        'A' => "022842 1535",
        'B' => "02083847463505 3544433202",
        'C' => "4738180703123243",
        'D' => "02082846442202",
        'E' => "42020848 0535",
        'F' => "020848 0535",
        'G' => "47381807031232434525",
        'H' => "0208 4248 0545",
        'I' => "2228 1232 1838",
        'J' => "4843321203",
        'K' => "0208 480542",
        'L' => "080242",
        'M' => "0208254842",
        'N' => "02084248",
        'O' => "180703123243473818",
        'P' => "02083847463505",
        'Q' => "180703123243473818 2442",
        'R' => "02083847463505 2542",
        'S' => "473818070615354443321203",
        'T' => "0848 2822",
        'U' => "080312324348",
        'V' => "082248",
        'W' => "0812253248",
        'X' => "0248 0842",
        'Y' => "082548 2522",
        'Z' => "08480242",
        'a' => "16364542 4414031232 3243",
        'b' => "0802 0516364543321203",
        'c' => "4536160503123243",
        'd' => "4842 4536160503123243",
        'e' => "0444453616050312 1232 3243",
        'f' => "48382722 1636",
        'g' => "4536160503123243 4641301001",
        'h' => "0802 0516364542",
        'i' => "2622 2828",
        'j' => "36312010 3838",
        'k' => "0802 360442",
        'l' => "2822",
        'm' => "0602 05162522 25364542",
        'n' => "0602 0516364542",
        'o' => "160503123243453616",
        'p' => "0600 0516364543321203",
        'q' => "4640 4536160503123243",
        'r' => "0602 05163645",
        's' => "45361605143443321203",
        't' => "28233242 1636",
        'u' => "0603123243 4642",
        'v' => "062246",
        'w' => "0612243246",
        'x' => "0246 0642",
        'y' => "0622 4610",
        'z' => "06460242",
        '0' => "180703123243473818 0347",
        '1' => "172822 1232",
        '2' => "07183847460242",
        '3' => "0718384746354443321203 1535",
        '4' => "32380444",
        '5' => "480805354443321203",
        '6' => "4738180703123243443505",
        '7' => "084812",
        '8' => "150607183847463515 1504031232434435 3515",
        '9' => "0312324347381807061545",
        '.' => "2222",
        ',' => "2211",
        '-' => "1535",
        ':' => "2323 2626",
        '!' => "2824 2222",
        '?' => "07183847462524 2222",
        '/' => "0248",
        '+' => "0545 2327",
        _ => "",
    }
}

/// The segments of a character, in units of the grid: `[x₀, y₀, x₁, y₁]`; y grows upwards.
pub(super) fn segments(character: char) -> impl Iterator<Item = [f32; 4]> {
    strokes(character).split(' ').filter(|line| line.len() >= 4).flat_map(|line| {
        let digit = |i: usize| f32::from(line.as_bytes()[i] - b'0');
        (0..line.len() / 2 - 1).map(move |i| [digit(2 * i), digit(2 * i + 1), digit(2 * i + 2), digit(2 * i + 3)])
    })
}

/// Left and right end of a character's strokes on the grid; a space is 1 to 3.
pub(super) fn extent(character: char) -> (f32, f32) {
    let ends = segments(character).flat_map(|s| [s[0], s[2]]);
    let (low, high) = ends.fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), x| (a.min(x), b.max(x)));
    if low <= high { (low, high) } else { (1.0, 3.0) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_stroke_is_pairs_of_digits_on_the_grid() {
        for character in ('!'..='z').chain([' ']) {
            for line in strokes(character).split(' ').filter(|l| !l.is_empty()) {
                assert!(line.len() % 2 == 0 && line.len() >= 4, "{character}: {line}");
                for (i, digit) in line.bytes().enumerate() {
                    let top = if i % 2 == 0 { b'4' } else { b'8' };
                    assert!((b'0'..=top).contains(&digit), "{character}: {line}");
                }
            }
            let (low, high) = extent(character);
            assert!((0.0..=4.0).contains(&low) && low <= high && high <= 4.0);
        }
        assert!(('A'..='Z').chain('a'..='z').chain('0'..='9').all(|c| segments(c).count() > 0));
        assert_eq!(segments('~').count(), 0);
    }
}
