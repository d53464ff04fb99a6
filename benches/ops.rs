//! `cargo bench -p effigy-benches`: the operators of `effigy bench`, one by one, under criterion. `EFFIGY_BENCH_SIDE_PX` sets the side of the
//! image (540); the body is the default one where it has been imported, else the small test body.

use std::time::{Duration, Instant};

use criterion::{Criterion, criterion_group, criterion_main};
use effigy::bench::Frame;
use effigy::body::Body;
use effigy::data_dir::body_path;
use effigy::gpu::{DeviceSelect, Gpu};

fn ops(criterion: &mut Criterion) {
    let side_px = std::env::var("EFFIGY_BENCH_SIDE_PX").map_or(540, |side| side.parse().expect("a number of pixels"));
    let path = body_path("default");
    let body = if path.is_file() { Body::load(&path).expect("the default body") } else { Body::test_body() };
    let gpu = Gpu::open(&DeviceSelect::Auto).expect("a device");
    let frame = Frame::new(&gpu, &body, side_px).expect("a frame");
    let mut group = criterion.benchmark_group(format!("{}/{side_px}", body.name));
    group.sample_size(20).measurement_time(Duration::from_secs(3));
    for case in frame.cases() {
        group.bench_function(case.name, |bencher| {
            bencher.iter_custom(|rounds| {
                // One submission, so that a launch is not counted with each round.
                let mut recorder = gpu.recorder(case.name);
                (0..rounds).for_each(|_| (case.record)(&mut recorder));
                let start = Instant::now();
                recorder.submit().expect("a submission");
                gpu.wait().expect("its end");
                start.elapsed()
            });
        });
    }
    group.finish();
}

criterion_group!(benches, ops);
criterion_main!(benches);
