//! Commands of a feature this build was made without: they exist, and say what to do.

use std::ffi::OsString;

use isoplanat::Error;

/// Takes whatever stands after the command's name.
#[derive(Debug, clap::Args)]
#[command(disable_help_flag = true)]
pub(crate) struct Args {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true, hide = true)]
    _rest: Vec<OsString>,
}

/// The error of a command that needs `feature`.
pub(crate) fn feature(feature: &str) -> anyhow::Result<()> {
    Err(Error::bad(
        "isoplanat",
        "command",
        format!("this build lacks the feature `{feature}`"),
        format!("build with --features {feature}"),
    )
    .into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_missing_feature_is_bad_input_and_says_how_to_get_it() {
        let error = feature("train").expect_err("always").downcast::<Error>().expect("our error");
        assert_eq!(error.exit_code(), 2);
        let text = error.to_string();
        assert!(text.contains("this build lacks the feature `train`; build with --features train"), "{text}");
    }
}
