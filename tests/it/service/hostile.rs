//! Clients and files that mean harm, on a real server.

use std::io::Write;
use std::net::TcpStream;
use std::time::{Duration, Instant};

use super::process::{Serve, Zeros};
use super::*;

pub fn start(data: &std::path::Path) -> (Serve, reqwest::blocking::Client) {
    let serve = Serve::start(data, &["--workers", "0"]);
    std::fs::write(data.join("bodies/default.body.npz"), b"").unwrap();
    (serve, blocking_client())
}

/// Whoever opens connections and does not end his requests.
#[test]
fn connections_that_do_not_end_their_requests_are_cut() {
    let data = tempfile::tempdir().unwrap();
    let (serve, _) = start(data.path());
    let mut slow = TcpStream::connect(serve.url.strip_prefix("http://").unwrap()).unwrap();
    slow.write_all(b"GET /v1/jobs HTTP/1.1\r\nhost: localhost\r\nx-slow: ").unwrap();
    slow.set_read_timeout(Some(Duration::from_secs(40))).unwrap();
    let begun = Instant::now();
    let _ = std::io::Read::read_to_end(&mut slow, &mut Vec::new());
    assert!(begun.elapsed() < Duration::from_secs(30), "a slow head is not cut");
}

/// Lets this process have so many files open.
pub fn allow_files(count: u64) {
    // SAFETY: both calls only read and write the given struct of numbers.
    unsafe {
        let mut limit = libc::rlimit { rlim_cur: 0, rlim_max: 0 };
        assert_eq!(libc::getrlimit(libc::RLIMIT_NOFILE, &mut limit), 0);
        limit.rlim_cur = limit.rlim_cur.max(count.min(limit.rlim_max));
        assert_eq!(libc::setrlimit(libc::RLIMIT_NOFILE, &limit), 0);
    }
}

/// A PNG whose header tells of 65,535² pixels, with hardly any data.
fn huge_png() -> Vec<u8> {
    let mut png = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |kind: &[u8], data: &[u8]| {
        png.extend((data.len() as u32).to_be_bytes());
        let body = [kind, data].concat();
        let mut crc = flate2::Crc::new();
        crc.update(&body);
        png.extend(body);
        png.extend(crc.sum().to_be_bytes());
    };
    let side = 65_535u32.to_be_bytes();
    chunk(b"IHDR", &[&side[..], &side, &[8, 6, 0, 0, 0]].concat());
    let mut zeros = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    for _ in 0..64 {
        zeros.write_all(&vec![0; 1 << 20]).unwrap();
    }
    chunk(b"IDAT", &zeros.finish().unwrap());
    chunk(b"IEND", &[]);
    png
}

/// An array whose header tells of more numbers than there is memory in the world.
fn absurd_npz() -> Vec<u8> {
    let header = "{'descr': '<f8', 'fortran_order': False, 'shape': (4000000000, 72), }\n";
    let mut npy = b"\x93NUMPY\x01\x00".to_vec();
    npy.extend((header.len() as u16).to_le_bytes());
    npy.extend(header.as_bytes());
    npy.extend([0; 64]);
    named_zip([("poses.npy".to_string(), npy.clone()), ("trans.npy".to_string(), npy)])
}

/// The beginning of an HDF5 file, which is no form of poses, with sizes that no machine has.
fn absurd_hdf5() -> Vec<u8> {
    let mut hdf5 = b"\x89HDF\r\n\x1a\n\x00\x00\x00\x00\x00\x08\x08\x00".to_vec();
    hdf5.extend([0xff; 4096]);
    hdf5
}

/// For an answer to a bomb.
const QUICK: Duration = Duration::from_secs(2);

/// How long the server took to refuse the form. The machine's other work must not decide: the best of three tries counts, unless an
/// earlier one is quick.
fn quickest_refusal(
    serve: &Serve,
    client: &reqwest::blocking::Client,
    form: &[u8],
    check: impl Fn(&Value),
) -> Duration {
    let mut best = Duration::MAX;
    for _ in 0..3 {
        let begun = Instant::now();
        let post = client.post(format!("{}/v1/jobs", serve.url)).header("content-type", Form::TYPE);
        let answer = post.body(form.to_vec()).send().unwrap();
        best = best.min(begun.elapsed());
        let status = answer.status().as_u16();
        let problem: Value = answer.json().unwrap();
        assert_eq!(problem["status"], status, "{problem}");
        check(&problem);
        if best < QUICK {
            break;
        }
    }
    best
}

#[test]
fn bombs_are_refused_quickly_and_in_little_memory() {
    let data = tempfile::tempdir().unwrap();
    let (serve, client) = start(data.path());
    let zip_bomb = named_zip((0..FRAMES).map(|i| (format!("{i}.png"), vec![0; 64 << 20])));
    let many = named_zip((0..70_000).map(|i| (format!("{i}.png"), Vec::new())));
    let deep = format!("{{\"format\": \"coco17\", \"frames\": {}", "[".repeat(2_000_000));
    let long_number = format!("{{\"format\": \"coco17\", \"frames\": [[[1{}, 1, 1]]]}}", "0".repeat(4_000_000));
    let cases = [
        ("masks", zip_bomb.clone()),
        ("video", zip_bomb),
        ("masks", many),
        ("masks", zip_of((0..FRAMES).map(|_| huge_png()))),
        ("video", zip_of((0..FRAMES).map(|_| huge_png()))),
        ("video", huge_png()),
        ("poses", absurd_npz()),
        ("poses", absurd_hdf5()),
        ("keypoints", deep.into_bytes()),
        ("keypoints", long_number.into_bytes()),
        ("camera", "[".repeat(500_000).into_bytes()),
        ("options", "{\"a\":".repeat(10_000).into_bytes()),
    ];
    for (part, content) in cases {
        let bytes = content.len();
        let body = Form::clip().with(part, content).body();
        let best = quickest_refusal(&serve, &client, &body, |problem| {
            assert!(matches!(problem["status"].as_u64(), Some(400 | 413 | 422)), "{problem}");
            assert!(problem["part"].as_str().unwrap().starts_with(part), "{problem}");
        });
        let peak = serve.peak_bytes() >> 20;
        eprintln!("{part}, {bytes} bytes: refused in {best:.2?}, peak {peak} MB");
        assert!(best < QUICK, "{part}: {best:?}");
        assert!(peak < 512, "{part}: {peak} MB");
    }
    assert_eq!(std::fs::read_dir(data.path().join("tmp")).unwrap().count(), 0);
}

#[test]
fn a_form_that_comes_to_no_part_is_refused_in_little_memory() {
    const BYTES: u64 = 64 << 20;
    let data = tempfile::tempdir().unwrap();
    let (serve, client) = start(data.path());
    assert!(client.get(format!("{}/healthz", serve.url)).send().unwrap().status().is_success());
    let before = serve.peak_bytes();
    for start in ["", "--effigy-test-boundary\r\nx-long: "] {
        let body = reqwest::blocking::Body::new(std::io::Read::chain(start.as_bytes(), Zeros(BYTES)));
        let post = client.post(format!("{}/v1/jobs", serve.url)).header("content-type", Form::TYPE).body(body);
        let problem: Value = post.send().unwrap().json().unwrap();
        assert_eq!(problem["type"], "urn:effigy:problem:malformed-request", "{problem}");
        assert!(problem["detail"].as_str().unwrap().starts_with("no part"), "{problem}");
    }
    let grown = serve.peak_bytes() - before;
    assert!(grown < 32 << 20, "grew by {grown} bytes");
    assert_eq!(std::fs::read_dir(data.path().join("tmp")).unwrap().count(), 0);
}

/// Whoever asks for much and reads nothing of it.
#[tokio::test(flavor = "multi_thread")]
async fn a_client_that_does_not_read_is_cut() {
    use tokio::io::{AsyncReadExt, AsyncWriteExt};
    // More than the system keeps for a connection.
    const BYTES: usize = 64 << 20;
    let bench = Bench::with_limits(Limits { patience: Duration::from_millis(100), ..Limits::default() }).await;
    let id = bench.publish(&[("avatar.glb", &vec![0; BYTES])]).await;
    let is_open = || {
        let open = std::fs::read_dir("/proc/self/fd").unwrap();
        let mut open = open.filter_map(|file| std::fs::read_link(file.unwrap().path()).ok());
        open.any(|file| file.starts_with(bench.store.root()) && file.ends_with("avatar.glb"))
    };
    let listener = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
    let address = listener.local_addr().unwrap();
    let (stop, stopped) = tokio::sync::oneshot::channel::<()>();
    let serve = tokio::spawn(effigy::http::serve(listener, bench.app.clone(), async { stopped.await.unwrap_or(()) }));
    let mut client = tokio::net::TcpStream::connect(address).await.unwrap();
    let request = format!("GET /v1/avatars/{id}/avatar.glb HTTP/1.1\r\nhost: localhost\r\n\r\n");
    client.write_all(request.as_bytes()).await.unwrap();
    client.readable().await.unwrap();
    let begun = Instant::now();
    while is_open() {
        assert!(begun.elapsed() < Duration::from_secs(60), "the file is still being sent");
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
    let mut came = Vec::new();
    let _ = client.read_to_end(&mut came).await;
    assert!(came.starts_with(b"HTTP/1.1 200 OK") && came.len() < BYTES, "{} bytes", came.len());
    drop(stop);
    serve.await.unwrap().unwrap();
}

/// A GIF of a million frames, each a pixel: 23 MB that a decoder is quick with.
fn million_frames() -> Vec<u8> {
    let mut gif = b"GIF89a\x10\0\x10\0\x80\0\0\0\0\0\xff\xff\xff".to_vec();
    let frame = b"\x21\xf9\x04\0\x04\0\0\0\x2c\0\0\0\0\x01\0\x01\0\0\x02\x02\x44\x01\0";
    gif.extend(frame.iter().copied().cycle().take(frame.len() * 1_000_000));
    gif.push(b';');
    gif
}

#[test]
fn a_video_of_a_million_frames_is_refused_quickly() {
    let data = tempfile::tempdir().unwrap();
    let (serve, client) = start(data.path());
    let body = Form::clip().with("video", million_frames()).body();
    let best = quickest_refusal(&serve, &client, &body, |problem| {
        assert_eq!((&problem["status"], &problem["part"]), (&json!(422), &json!("video")), "{problem}");
        assert!(problem["detail"].as_str().unwrap().contains("more than 3600 frames"), "{problem}");
    });
    let peak = serve.peak_bytes() >> 20;
    eprintln!("a million frames: refused in {best:.2?}, server at most {peak} MB");
    assert!(best < QUICK && peak < 512, "{best:?}, {peak} MB");
}

#[test]
fn media_that_name_other_files_and_hosts_reach_none() {
    let data = tempfile::tempdir().unwrap();
    let (serve, client) = start(data.path());
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    listener.set_nonblocking(true).unwrap();
    let host = listener.local_addr().unwrap();
    // A clip that would be fine, if it could be reached.
    let outside = tempfile::tempdir().unwrap();
    let secret = outside.path().join("secret.png");
    std::fs::write(&secret, picture(0, 3)).unwrap();
    let secret = secret.display();
    let playlist = |entry: &str| format!("#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{entry}\n#EXT-X-ENDLIST\n");
    let cases = [
        playlist(&format!("http://{host}/a.ts")),
        playlist(&format!("file://{secret}")),
        playlist(&format!("concat:{secret}|{secret}")),
        playlist(&format!("subfile,,start,0,end,100,,:{secret}")),
        format!("ffconcat version 1.0\nfile {secret}\nduration 1\n"),
        format!("ffconcat version 1.0\nfile http://{host}/a.mp4\n"),
        format!(
            "<?xml version=\"1.0\"?><MPD xmlns=\"urn:mpeg:dash:schema:mpd:2011\" type=\"static\"><Period>\
                 <AdaptationSet mimeType=\"video/mp4\"><Representation id=\"1\"><BaseURL>http://{host}/a.mp4</BaseURL>\
                 </Representation></AdaptationSet></Period></MPD>"
        ),
        format!("v=0\no=- 0 0 IN IP4 127.0.0.1\ns=x\nc=IN IP4 127.0.0.1\nt=0 0\nm=video {} RTP/AVP 96\n", host.port()),
        format!("<svg xmlns=\"http://www.w3.org/2000/svg\"><image href=\"file://{secret}\"/></svg>"),
        format!("# VobSub index file, v7 (do not modify this line!)\nid: en, index: 0\n{secret}\n"),
    ];
    for part in ["video", "masks"] {
        for text in &cases {
            let body = Form::clip().with(part, text.clone()).body();
            let begun = Instant::now();
            let answer = client.post(format!("{}/v1/jobs", serve.url)).header("content-type", Form::TYPE).body(body);
            let answer = answer.send().unwrap();
            let status = answer.status().as_u16();
            let problem = answer.text().unwrap();
            assert_eq!(status, 422, "{text}: {problem}");
            assert!(!problem.contains("secret"), "{problem}");
            assert!(begun.elapsed() < Duration::from_secs(10), "{text}");
        }
    }
    assert!(listener.accept().is_err(), "the decoder called out");
}

/// Small clips in containers and codecs that every FFmpeg can write.
fn clips(folder: &std::path::Path) -> Vec<Vec<u8>> {
    let kinds =
        [("mp4", "mpeg4"), ("avi", "mjpeg"), ("ts", "mpeg2video"), ("mkv", "ffv1"), ("mov", "png"), ("flv", "flv1")];
    let clip = |(container, codec): (&str, &str)| {
        let path = folder.join(format!("clip.{container}"));
        let source = format!("testsrc=size={WIDTH}x{HEIGHT}:rate=25,trim=end_frame={FRAMES}");
        let mut ffmpeg = std::process::Command::new("ffmpeg");
        ffmpeg.args(["-v", "error", "-f", "lavfi", "-i", &source, "-c:v", codec, "-q:v", "2"]).arg(&path);
        assert!(ffmpeg.status().unwrap().success(), "{container}");
        std::fs::read(path).unwrap()
    };
    kinds.into_iter().map(clip).collect()
}

/// Flips, cuts, doubles or blanks something.
fn damage(clip: &[u8], random: &mut rand_pcg::Pcg64Mcg) -> Vec<u8> {
    use rand::RngExt;
    let mut clip = clip.to_vec();
    let (at, length) = (random.random_range(0..clip.len()), random.random_range(1..512));
    let range = at..(at + length).min(clip.len());
    match random.random_range(0..8) {
        0 => clip.truncate(at),
        1 => clip.extend_from_within(range),
        2 => clip[range].fill(random.random()),
        3 => drop(clip.drain(range)),
        // Headers are where parsers live.
        4 => (0..4).for_each(|_| clip[random.random_range(0..64)] = random.random()),
        _ => (0..length / 8 + 1).for_each(|_| {
            let at = random.random_range(0..clip.len());
            clip[at] = random.random();
        }),
    }
    clip
}

/// Corrupted streams: `EFFIGY_TORTURE_STREAMS` of them.
#[test]
fn corrupted_streams_leave_the_server_unharmed() {
    use rand::SeedableRng;
    let streams = std::env::var("EFFIGY_TORTURE_STREAMS").map_or(100, |text| text.parse::<u64>().unwrap());
    let data = tempfile::tempdir().unwrap();
    let (serve, client) = start(data.path());
    let folder = tempfile::tempdir().unwrap();
    let clips = clips(folder.path());
    let next = std::sync::atomic::AtomicU64::new(0);
    let post = |video: Vec<u8>| {
        let body = Form::clip().with("video", video).body();
        client.post(format!("{}/v1/jobs", serve.url)).header("content-type", Form::TYPE).body(body).send().unwrap()
    };
    let (accepted, slowest) = (std::sync::atomic::AtomicU64::new(0), Mutex::new(Duration::ZERO));
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let seed = next.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                    if seed >= streams {
                        break;
                    }
                    let mut random = rand_pcg::Pcg64Mcg::seed_from_u64(seed);
                    let video = damage(&clips[seed as usize % clips.len()], &mut random);
                    let begun = Instant::now();
                    let answer = post(video);
                    let took = begun.elapsed();
                    assert!(took < Duration::from_secs(20), "stream {seed}: {took:?}");
                    let mut slowest = slowest.lock().unwrap();
                    *slowest = took.max(*slowest);
                    match answer.status().as_u16() {
                        // What the damage hit need not matter.
                        202 => {
                            accepted.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
                            // Thousands of jobs would fill the queue, as they should.
                            let job: Value = answer.json().unwrap();
                            let url = format!("{}/v1/jobs/{}", serve.url, job["id"].as_str().unwrap());
                            assert_eq!(client.delete(url).send().unwrap().status(), 204, "stream {seed}");
                        }
                        // One that became another size or length is still a video: then the rest does not fit it.
                        422 => {
                            let problem: Value = answer.json().unwrap();
                            let part = problem["part"].as_str().unwrap_or("none");
                            assert!(["video", "masks", "keypoints"].contains(&part), "stream {seed}: {problem}");
                        }
                        other => panic!("stream {seed}: {other}: {}", answer.text().unwrap()),
                    }
                }
            });
        }
    });
    let (accepted, slowest, peak) = (accepted.into_inner(), slowest.into_inner().unwrap(), serve.peak_bytes() >> 20);
    eprintln!("{streams} corrupted streams: {accepted} still usable, slowest {slowest:.1?}, server at most {peak} MB");
    assert!(accepted < streams * 9 / 10, "the damage does damage");
    assert!(peak < 256, "{peak} MB");
    assert_eq!(post(clips[0].clone()).status(), 202, "a good clip");
    assert_eq!(std::fs::read_dir(data.path().join("tmp")).unwrap().count(), 0);
}
