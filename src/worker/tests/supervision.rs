//! The supervisor with small programs in the worker's place.

use super::super::channel;
use super::*;
use crate::jobs::render::{Renderer, What};

/// Answers each request by writing its line to the file that it names.
const ANSWERING: &str = r#"while read -r line; do
    id=${line#*\"id\":}; id=${id%%,*}
    to=${line##*\"to\":\"}; to=${to%%\"*}
    echo "$line" > "$to"
    echo "{\"id\":$id,\"result\":{\"Ok\":null}}"
done"#;

fn supervise(folder: &Path, script: &str, settings: impl FnOnce(&mut SupervisorSettings)) -> Arc<Supervisor> {
    let arguments = vec!["-c".to_string(), script.to_string()];
    let mut chosen = SupervisorSettings::new("sh".into(), arguments, folder.into());
    chosen.backoff = Duration::from_millis(1);
    settings(&mut chosen);
    let supervisor = Supervisor::new(chosen);
    tokio::spawn(supervisor.clone().run());
    supervisor
}

fn request() -> RenderRequest {
    RenderRequest { model: "model.npz".into(), what: What::Mesh { frame: 3 } }
}

/// Polls once.
async fn is_waiting(future: impl Future + Unpin) -> bool {
    tokio::select! {
        biased;
        _ = future => false,
        () = std::future::ready(()) => true,
    }
}

#[tokio::test]
async fn a_render_goes_to_the_worker_and_comes_back_as_a_file() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervise(folder.path(), ANSWERING, |_| {});
    let file = supervisor.render(request()).await.unwrap();
    assert!(std::fs::read_to_string(file).unwrap().contains("\"frame\":3"));
    assert_eq!(supervisor.trouble(), None);
    supervisor.stop();
}

#[tokio::test]
async fn a_worker_that_dies_is_started_again_and_gets_the_request_once_more() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("died");
    let script = format!("if [ ! -e {0} ]; then read -r line; touch {0}; kill -9 $$; fi\n{ANSWERING}", mark.display());
    let supervisor = supervise(folder.path(), &script, |_| {});
    assert!(supervisor.render(request()).await.unwrap().exists());
    assert!(mark.exists());
    supervisor.stop();
}

#[tokio::test]
async fn a_request_that_kills_its_worker_is_given_up() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervise(folder.path(), "read -r line; kill -9 $$", |_| {});
    assert!(matches!(supervisor.render(request()).await, Err(RenderError::Failed(_))));
    supervisor.stop();
}

#[tokio::test]
async fn a_worker_without_a_device_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let [lost, found] = ["lost", "found"].map(|name| folder.path().join(name));
    let await_ = |file: &Path| format!("while [ ! -e {} ]; do sleep 0.01; done", file.display());
    let script = format!(
        "echo '{}'; {}; echo '{}'; {}; kill -9 $$",
        json!({ "device": { "Err": "it is taken" } }),
        await_(&found),
        json!({ "device": { "Ok": null } }),
        await_(&lost),
    );
    let supervisor = supervise(folder.path(), &script, |s| s.backoff = Duration::from_secs(60));
    let told = |word: &str| supervisor.trouble().is_some_and(|trouble| trouble.contains(word));
    while !told("it is taken") {
        tokio::task::yield_now().await;
    }
    std::fs::write(found, "").unwrap();
    while supervisor.trouble().is_some() {
        tokio::task::yield_now().await;
    }
    std::fs::write(lost, "").unwrap();
    while !told("starting") {
        tokio::task::yield_now().await;
    }
    supervisor.stop();
}

#[tokio::test]
async fn a_worker_that_is_silent_or_never_starts_is_unavailable() {
    let folder = tempfile::tempdir().unwrap();
    for script in ["cat > /dev/null", "exit 1"] {
        let supervisor = supervise(folder.path(), script, |s| s.timeout = Duration::from_millis(50));
        let answer = supervisor.render(request()).await;
        assert!(matches!(answer, Err(RenderError::Unavailable(_) | RenderError::Failed(_))), "{answer:?}");
        supervisor.stop();
    }
}

#[tokio::test]
async fn who_waits_for_a_picture_learns_at_once_that_the_server_ends() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervise(folder.path(), "cat > /dev/null", |_| {});
    let mut waits = supervisor.render(request());
    while supervisor.trouble().is_some() {
        tokio::time::sleep(Duration::from_millis(5)).await;
    }
    assert!(is_waiting(&mut waits).await);
    supervisor.stop();
    let answer =
        tokio::time::timeout(Duration::from_secs(10), waits).await.expect("no waiting for a worker that never comes");
    assert!(matches!(answer, Err(RenderError::Unavailable(_))), "{answer:?}");
}

#[tokio::test]
async fn a_request_keeps_its_place_over_its_workers_death() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().join("died");
    let script = format!("if [ ! -e {0} ]; then read -r line; touch {0}; kill -9 $$; fi\n{ANSWERING}", mark.display());
    let supervisor = supervise(folder.path(), &script, |s| {
        s.queue = 1;
        s.backoff = Duration::from_millis(200);
    });
    while supervisor.trouble().is_some() {
        tokio::task::yield_now().await;
    }
    let mut first = supervisor.render(request());
    assert!(is_waiting(&mut first).await);
    while !mark.exists() || supervisor.trouble().is_none() {
        tokio::task::yield_now().await;
    }
    // The first one has not been polled since its worker died.
    assert!(matches!(supervisor.render(request()).await, Err(RenderError::Busy)), "its place is not free meanwhile");
    assert!(first.await.unwrap().exists());
    supervisor.stop();
}

#[tokio::test]
async fn a_worker_that_answers_nothing_is_killed_and_started_anew() {
    let folder = tempfile::tempdir().unwrap();
    let starts = folder.path().join("starts");
    let script =
        format!("echo >> {0}; if [ $(wc -l < {0}) = 1 ]; then exec sleep 3600; fi\n{ANSWERING}", starts.display());
    let started = || std::fs::read(&starts).map_or(0, |lines| lines.len());
    let supervisor = supervise(folder.path(), &script, |s| s.silence = Duration::from_secs(2));
    while started() == 0 {
        tokio::task::yield_now().await;
    }
    tokio::time::sleep(Duration::from_secs(3)).await;
    assert_eq!(started(), 1, "nobody waits: it may be as silent as it likes");
    assert!(supervisor.render(request()).await.unwrap().exists(), "the next worker gets the request");
    assert_eq!(started(), 2);
    supervisor.stop();
}

#[tokio::test]
async fn too_many_renders_are_refused_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervise(folder.path(), "cat > /dev/null", |s| {
        s.queue = 1;
        s.timeout = Duration::from_secs(3600);
    });
    let mut first = supervisor.render(request());
    assert!(is_waiting(&mut first).await);
    assert!(matches!(supervisor.render(request()).await, Err(RenderError::Busy)));
    drop(first);
    let mut next = supervisor.render(request());
    assert!(is_waiting(&mut next).await, "a client that went away before a worker was there leaves its place");
    supervisor.stop();
}

#[tokio::test]
async fn a_picture_that_nobody_waits_for_has_its_place_until_it_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    let go = folder.path().join("go");
    let script = format!("while [ ! -e {} ]; do sleep 0.01; done\n{ANSWERING}", go.display());
    let supervisor = supervise(folder.path(), &script, |s| s.queue = 1);
    while supervisor.trouble().is_some() {
        tokio::task::yield_now().await;
    }
    let mut first = supervisor.render(request());
    assert!(is_waiting(&mut first).await);
    drop(first);
    assert!(matches!(supervisor.render(request()).await, Err(RenderError::Busy)));
    std::fs::write(go, "").unwrap();
    while let Err(busy) = supervisor.render(request()).await {
        assert!(matches!(busy, RenderError::Busy), "{busy:?}");
        tokio::task::yield_now().await;
    }
    supervisor.stop();
}

#[tokio::test]
async fn a_file_that_nobody_takes_goes() {
    let folder = tempfile::tempdir().unwrap();
    let supervisor = supervise(folder.path(), ANSWERING, |_| {});
    let files = || std::fs::read_dir(folder.path()).unwrap().count();
    while supervisor.trouble().is_some() {
        tokio::task::yield_now().await;
    }
    let mut first = supervisor.render(request());
    assert!(is_waiting(&mut first).await);
    // Answers come in order.
    drop(supervisor.render(request()).await.unwrap());
    assert_eq!(files(), 1, "the first one's, whose client has not been told yet");
    drop(first);
    assert_eq!(files(), 0);
    supervisor.stop();
}

#[tokio::test]
async fn the_channel_ends_with_the_server() {
    let folder = tempfile::tempdir().unwrap();
    let device = DeviceThread::start(ScriptedEngine(Arc::new(endless))).unwrap();
    let to = folder.path().join("mesh.ply");
    let line = json!({ "id": 1, "request": request(), "to": to });
    channel::serve(format!("{line}\nnonsense\n").as_bytes(), &device).unwrap();
    let (done, drawn) = tokio::sync::oneshot::channel();
    device.draw(request(), folder.path().join("last.ply"), |result| done.send(result).unwrap());
    drawn.await.unwrap().unwrap();
    assert!(to.exists(), "requests are drawn in order");
}
