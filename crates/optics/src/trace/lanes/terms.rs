//! Numbers of terms that kernels are compiled for.

/// Calls `$call` with the constant `$n`, the least of those compiled that is not below `$terms`.
macro_rules! with_terms {
    ($terms:expr, $n:ident => $call:expr) => {
        with_terms!(@ $terms, $n => $call; 0..=2, 2; 3, 3; 4, 4; 5, 5; 6, 6; 7..=8, 8; _, 10)
    };
    (@ $terms:expr, $n:ident => $call:expr; $($some:pat, $value:literal);+) => {
        match $terms {
            $($some => {
                const $n: usize = $value;
                $call
            })+
        }
    };
}

pub(super) use with_terms;
