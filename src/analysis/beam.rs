//! All rays of one object point and wavelength, over the stop.
