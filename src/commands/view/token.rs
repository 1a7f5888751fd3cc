//! The word that whoever asks must know.

use isoplanat::{Error, Result};

/// 128 bits of the system's generator, as 32 hexadecimal digits; one for each run of the server.
pub(super) struct Token(String);

impl Token {
    /// A new one.
    ///
    /// # Errors
    /// A system without a generator of random numbers.
    pub(super) fn new() -> Result<Self> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes)
            .map_err(|e| Error::Stopped(format!("the system gives no random numbers for the address: {e}")))?;
        Ok(Self(bytes.iter().map(|byte| format!("{byte:02x}")).collect()))
    }

    /// The digits.
    pub(super) fn as_str(&self) -> &str {
        &self.0
    }

    /// Whether the query of an address has it. The time taken does not depend on where two texts of this length differ.
    pub(super) fn is_in(&self, query: &str) -> bool {
        let Some(text) = query.split('&').find_map(|part| part.strip_prefix("token=")) else { return false };
        let differences = text.bytes().zip(self.0.bytes()).fold(0, |all, (a, b)| std::hint::black_box(all | (a ^ b)));
        text.len() == self.0.len() && differences == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_the_whole_token_is_taken() {
        let token = Token::new().expect("random numbers");
        let own = token.as_str();
        assert!(own.len() == 32 && own != Token::new().expect("random numbers").as_str());
        for right in [format!("token={own}"), format!("a=b&token={own}&c=d")] {
            assert!(token.is_in(&right), "{right}");
        }
        let last = if own.ends_with('0') { '1' } else { '0' };
        for wrong in [
            String::new(),
            "token".into(),
            "token=".into(),
            format!("token={}", &own[..31]),
            format!("token={own}0"),
            format!("token={}{last}", &own[..31]),
            format!("Token={own}"),
            format!("xtoken={own}"),
            format!("token=&token={own}"),
        ] {
            assert!(!token.is_in(&wrong), "{wrong}");
        }
    }
}
