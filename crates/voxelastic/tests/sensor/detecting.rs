//! Recognition of sensors.
