use super::*;
use crate::atomic_file;

fn store() -> (tempfile::TempDir, Store) {
    let folder = tempfile::tempdir().unwrap();
    let store = Store::open(&folder.path().join("data")).unwrap();
    (folder, store)
}

async fn upload(store: &Store, content: &[u8]) -> Upload {
    let upload = store.begin_upload().unwrap();
    let mut part = upload.part("video").await.unwrap();
    part.write(content).await.unwrap();
    assert_eq!(part.finish().await.unwrap(), content.len() as u64);
    upload
}

#[tokio::test]
async fn an_upload_appears_whole_or_not_at_all() {
    let (_folder, store) = store();
    let job = Uuid::new_v4();
    drop(upload(&store, b"lost").await);
    assert_eq!(names(&store.tmp()).unwrap().len(), 0);
    let kept = upload(&store, b"kept").await;
    assert!(!store.inputs(job).exists());
    store.commit_upload(kept, job).unwrap();
    assert_eq!(fs::read(store.inputs(job).join("video")).unwrap(), b"kept");
    assert_eq!(names(&store.tmp()).unwrap().len(), 0);
}

#[tokio::test]
async fn a_start_removes_what_a_killed_server_left() {
    let (_folder, store) = store();
    let (known, orphan) = (Uuid::new_v4(), Uuid::new_v4());
    for job in [known, orphan] {
        store.commit_upload(upload(&store, b"clip").await, job).unwrap();
    }
    std::mem::forget(upload(&store, b"half").await);
    fs::write(store.renders().join("old.png"), b"png").unwrap();
    store.clean(&HashSet::from([known])).unwrap();
    assert_eq!(store.job_folders().unwrap(), [known]);
    assert!(names(&store.tmp()).unwrap().is_empty() && names(&store.renders()).unwrap().is_empty());
}

#[test]
fn deleting_twice_is_deleting_once() {
    let (_folder, store) = store();
    let job = Uuid::new_v4();
    fs::create_dir_all(store.results(job, 1)).unwrap();
    store.delete_job(job).unwrap();
    store.delete_job(job).unwrap();
    assert!(store.job_folders().unwrap().is_empty());
}

#[test]
fn tidying_keeps_the_published_epoch() {
    let (_folder, store) = store();
    let job = Uuid::new_v4();
    for epoch in [1, 2, 3] {
        fs::create_dir_all(store.results(job, epoch)).unwrap();
    }
    fs::create_dir_all(store.work(job)).unwrap();
    store.tidy_job(job, Some(2)).unwrap();
    assert!(store.results(job, 2).exists() && !store.results(job, 1).exists() && !store.work(job).exists());
    store.tidy_job(job, None).unwrap();
    assert!(!store.results(job, 2).exists());
}

#[test]
fn sealing_hashes_what_is_published() {
    let folder = tempfile::tempdir().unwrap();
    atomic_file::write(&folder.path().join("b.txt"), b"abc").unwrap();
    atomic_file::write(&folder.path().join("a.txt"), b"").unwrap();
    fs::write(folder.path().join(".part"), b"half").unwrap();
    let sealed = Published::seal(folder.path()).unwrap();
    assert_eq!(sealed.iter().map(|f| (f.name.as_str(), f.bytes)).collect::<Vec<_>>(), [("a.txt", 0), ("b.txt", 3)]);
    assert_eq!(sealed[1].sha256, "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
}

#[test]
fn ranges_follow_rfc_9110() {
    let range = |start, end| Some(Ok(ByteRange { start, end }));
    for (header, expected) in [
        ("bytes=0-", range(0, 100)),
        ("bytes=10-19", range(10, 20)),
        ("bytes=90-200", range(90, 100)),
        ("Bytes = 99-99", range(99, 100)),
        ("bytes=-5", range(95, 100)),
        ("bytes=-500", range(0, 100)),
        ("bytes=0-99999999999999999999999", range(0, 100)),
        ("bytes=100-", Some(Err(()))),
        ("bytes=99999999999999999999999-", Some(Err(()))),
        ("bytes=-0", Some(Err(()))),
        ("bytes=5-4", None),
        ("bytes=0-1,5-6", None),
        ("lines=0-1", None),
        ("bytes=a-b", None),
        ("bytes=+1-2", None),
        ("bytes", None),
    ] {
        assert_eq!(parse_range(header, 100), expected, "{header}");
    }
    assert_eq!(parse_range("bytes=0-", 0), Some(Err(())));
}

#[cfg(unix)]
#[test]
fn a_folder_that_is_made_is_this_users_alone_and_one_that_is_there_stays_as_it_is() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::Builder::new().permissions(fs::Permissions::from_mode(0o755)).tempdir().unwrap();
    let mode = |path: &Path| fs::metadata(path).unwrap().permissions().mode() & 0o777;
    // But for the folder of all temporary ones, which may be hidden itself.
    let is_public = std::env::temp_dir().ancestors().all(|folder| mode(folder) & 1 == 1);
    let made = folder.path().join("made/data");
    assert!(!Store::open(&made).unwrap().is_open_to_all());
    assert_eq!(mode(&made), 0o700);
    let there = folder.path().join("there");
    fs::create_dir(&there).unwrap();
    fs::set_permissions(&there, fs::Permissions::from_mode(0o755)).unwrap();
    assert_eq!(Store::open(&there).unwrap().is_open_to_all(), is_public);
    assert_eq!(mode(&there), 0o755);
}
