//! Statements of a CODE V sequence: words, with comments, continuations and quotes resolved.

/// One statement: at least one word.
pub(super) struct Statement<'a> {
    /// The line that it begins on, from 1.
    pub(super) line: usize,
    pub(super) words: Vec<&'a str>,
}

/// Splits a text at line ends and semicolons outside quotes; `!` begins a comment, `&` at a line's end continues it.
pub(super) fn statements(text: &str) -> Vec<Statement<'_>> {
    let mut found = Vec::new();
    let (mut words, mut begun): (Vec<&str>, usize) = (Vec::new(), 1);
    for (number, line) in text.lines().enumerate() {
        let mut rest = line;
        let mut continued = false;
        loop {
            rest = rest.trim_start();
            let Some(first) = rest.chars().next() else { break };
            if words.is_empty() {
                begun = number + 1;
            }
            match first {
                '!' => break,
                ';' => {
                    end(&mut found, &mut words, begun);
                    rest = &rest[1..];
                }
                '&' if rest[1..].trim().is_empty() => {
                    continued = true;
                    break;
                }
                '\'' | '"' => {
                    let inside = &rest[1..];
                    let close = inside.find(first).unwrap_or(inside.len());
                    words.push(&inside[..close]);
                    rest = inside.get(close + 1..).unwrap_or("");
                }
                _ => {
                    let close = rest.find(|c: char| c.is_whitespace() || c == ';' || c == '!').unwrap_or(rest.len());
                    words.push(&rest[..close]);
                    rest = &rest[close..];
                }
            }
        }
        if !continued {
            end(&mut found, &mut words, begun);
        }
    }
    end(&mut found, &mut words, begun);
    found
}

fn end<'a>(found: &mut Vec<Statement<'a>>, words: &mut Vec<&'a str>, line: usize) {
    if !words.is_empty() {
        found.push(Statement { line, words: std::mem::take(words) });
    }
}

#[cfg(test)]
mod tests {
    use super::statements;

    #[test]
    fn quotes_comments_and_continuations() {
        let text = "RDM;LEN \"a; b\"\nTITLE 'x ! y' ! end\nWL 1 2 &\n 3\n\n! all\nS 1 2;  STO";
        let all: Vec<(usize, Vec<&str>)> = statements(text).into_iter().map(|s| (s.line, s.words)).collect();
        let expected: Vec<(usize, Vec<&str>)> = vec![
            (1, vec!["RDM"]),
            (1, vec!["LEN", "a; b"]),
            (2, vec!["TITLE", "x ! y"]),
            (3, vec!["WL", "1", "2", "3"]),
            (7, vec!["S", "1", "2"]),
            (7, vec!["STO"]),
        ];
        assert_eq!(all, expected);
    }
}
