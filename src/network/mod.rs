//! The reconstruction network: configuration and card here without burn; model, training and export behind `train`.
