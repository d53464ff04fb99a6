//! Effigy: rigged, textured, animatable 3D avatars from ordinary video. ARCHITECTURE.md has the map.

// What wgpu's handles are made of is nested deeper than the compiler follows by default when it proves them `Send`.
#![recursion_limit = "256"]

pub mod atomic_file;
pub mod avatar;
pub mod bench;
pub mod body;
pub mod camera;
pub mod capture;
pub mod config;
pub mod data_dir;
pub mod distance;
pub mod eval;
pub mod fingerprint;
pub mod fit;
pub mod fuzz_entries;
pub mod gpu;
pub mod http;
pub mod jobs;
pub mod json;
pub mod keypoints;
pub mod mask;
pub mod math;
pub mod novel;
pub mod npz;
pub mod ops;
pub mod page;
pub mod picture;
pub mod quality;
pub mod robustness;
pub mod storage;
pub mod study;
pub mod synth;
pub mod telemetry;
pub mod video_writer;
pub mod webhooks;
pub mod worker;
