//! The worker: claims jobs, runs them on the device's own thread, and draws for the server.

pub mod pipeline;
