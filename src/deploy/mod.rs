//! The camera side: RAW in, picture out. No training code, no gradients.
