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
                '&' if last(&rest[1..]) => {
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
                    // An `&` at the line's end may stand next to its last word.
                    let ends = |(at, c): (usize, char)| {
                        c.is_whitespace() || matches!(c, ';' | '!') || (c == '&' && last(&rest[at + 1..]))
                    };
                    let close = rest.char_indices().find(|x| ends(*x)).map_or(rest.len(), |(at, _)| at);
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

/// Whether nothing but a comment follows on the line.
fn last(rest: &str) -> bool {
    let rest = rest.trim_start();
    rest.is_empty() || rest.starts_with('!')
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
        let text =
            "RDM;LEN \"a; b\"\nTITLE 'x ! y' ! end\nWL 1 2 &\n 3\n\n! all\nS 1 2;  STO\nA 1& ! on\n 2&\n\nGLA A&B";
        let all: Vec<(usize, Vec<&str>)> = statements(text).into_iter().map(|s| (s.line, s.words)).collect();
        let expected: Vec<(usize, Vec<&str>)> = vec![
            (1, vec!["RDM"]),
            (1, vec!["LEN", "a; b"]),
            (2, vec!["TITLE", "x ! y"]),
            (3, vec!["WL", "1", "2", "3"]),
            (7, vec!["S", "1", "2"]),
            (7, vec!["STO"]),
            (8, vec!["A", "1", "2"]),
            (11, vec!["GLA", "A&B"]),
        ];
        assert_eq!(all, expected);
    }
}
