//! The queue under random histories: workers that lose their leases and go on all the same, users, reapers and clocks in
//! any order. Whatever happens, the rules below hold after each step, and every job comes to an end.

use std::collections::BTreeMap;
use std::time::Duration;

use proptest::prelude::*;
use proptest::test_runner::Config;
use uuid::Uuid;

use super::super::conformance::{Bench, avatar, new_job};
use super::super::{Change, Job, JobError, Lease, ListFilter, Repeat, Standing, State};
use super::tests::open;

/// What somebody does. Numbers choose a job or a lease, whatever there is.
#[derive(Clone, Debug)]
enum Deed {
    Insert {
        priority: i32,
        deadline_secs: Option<u64>,
    },
    Claim {
        worker: u8,
    },
    Pass {
        secs: u64,
    },
    /// Somebody sets the wall clock, and a worker writes before anybody else.
    Leap {
        secs: u64,
        forward: bool,
    },
    Reap,
    WorkerDies {
        worker: u8,
    },
    Heartbeat {
        lease: usize,
    },
    Saved {
        lease: usize,
        percent: u8,
    },
    Succeed {
        lease: usize,
    },
    Fail {
        lease: usize,
        repeat: Repeat,
    },
    GiveBack {
        lease: usize,
    },
    ConfirmCancel {
        lease: usize,
    },
    Cancel {
        job: usize,
    },
    Retry {
        job: usize,
    },
    Delete {
        job: usize,
    },
}

fn deeds() -> impl Strategy<Value = Deed> {
    use Deed::*;
    let repeat = prop_oneof![Just(Repeat::Never), Just(Repeat::Counted), Just(Repeat::Killed)];
    let deadline = prop_oneof![3 => Just(None), 1 => (10..300u64).prop_map(Some)];
    prop_oneof![
        3 => (-2..3, deadline).prop_map(|(priority, deadline_secs)| Insert { priority, deadline_secs }),
        6 => (0..3u8).prop_map(|worker| Claim { worker }),
        4 => prop_oneof![0..5u64, 30..70u64, 600..700u64].prop_map(|secs| Pass { secs }),
        1 => (60..200_000u64, any::<bool>()).prop_map(|(secs, forward)| Leap { secs, forward }),
        3 => Just(Reap),
        1 => (0..3u8).prop_map(|worker| WorkerDies { worker }),
        2 => any::<usize>().prop_map(|lease| Heartbeat { lease }),
        3 => (any::<usize>(), 0..=100u8).prop_map(|(lease, percent)| Saved { lease, percent }),
        2 => any::<usize>().prop_map(|lease| Succeed { lease }),
        2 => (any::<usize>(), repeat).prop_map(|(lease, repeat)| Fail { lease, repeat }),
        1 => any::<usize>().prop_map(|lease| GiveBack { lease }),
        1 => any::<usize>().prop_map(|lease| ConfirmCancel { lease }),
        2 => any::<usize>().prop_map(|job| Cancel { job }),
        1 => any::<usize>().prop_map(|job| Retry { job }),
        1 => any::<usize>().prop_map(|job| Delete { job }),
    ]
}

struct World {
    bench: Bench,
    /// Every lease that was ever given, also those that were lost.
    leases: Vec<Lease>,
    ids: Vec<Uuid>,
    /// States as they were seen, by job.
    seen: BTreeMap<Uuid, Vec<State>>,
}

fn pick<T: Clone>(from: &[T], n: usize) -> Option<T> {
    (!from.is_empty()).then(|| from[n % from.len()].clone())
}

impl World {
    async fn jobs(&self) -> BTreeMap<Uuid, Job> {
        let all = ListFilter { limit: 10_000, ..ListFilter::default() };
        self.bench.queue.list(all).await.unwrap().into_iter().map(|job| (job.id, job)).collect()
    }

    async fn act(&mut self, deed: &Deed) {
        let before = self.jobs().await;
        let queue = self.bench.queue.clone();
        match deed {
            Deed::Insert { priority, deadline_secs } => {
                self.bench.clock.advance(Duration::from_millis(1));
                let mut new = new_job(&self.bench.env);
                (new.options.priority, new.options.deadline_secs) = (*priority, *deadline_secs);
                self.ids.push(new.id);
                queue.insert(new).await.unwrap().queued().unwrap();
            }
            Deed::Claim { worker } => self.claim(&before, *worker).await,
            Deed::Pass { secs } => self.bench.clock.advance(Duration::from_secs(*secs)),
            Deed::Leap { secs, forward } => {
                self.bench.clock.leap(Duration::from_secs(*secs), *forward);
                queue.heartbeat(&Lease { job: Uuid::nil(), epoch: 0 }).await.unwrap();
            }
            Deed::Reap => drop(queue.reap().await.unwrap()),
            Deed::WorkerDies { worker } => {
                let owner = format!("worker-{worker}");
                let released = queue.release_owner(&owner).await.unwrap();
                let held = before.values().filter(|job| job.owner.as_deref() == Some(&owner)).count();
                assert_eq!(released.len(), held);
            }
            Deed::Cancel { job } => {
                if let Some(id) = pick(&self.ids, *job) {
                    let open = before.get(&id).is_some_and(|job| !job.state.is_final());
                    let canceled = matches!(queue.cancel(id).await.unwrap(), Change::Done(_));
                    assert!(canceled || !open);
                }
            }
            Deed::Retry { job } => {
                if let Some(id) = pick(&self.ids, *job) {
                    drop(queue.retry(id).await.unwrap());
                }
            }
            Deed::Delete { job } => {
                if let Some(id) = pick(&self.ids, *job) {
                    queue.delete(id).await.unwrap();
                }
            }
            of_a_worker => self.work(&before, of_a_worker).await,
        }
        self.check(&before, deed).await;
    }

    /// The claim takes the right job, and no other.
    async fn claim(&mut self, before: &BTreeMap<Uuid, Job>, worker: u8) {
        let now = self.bench.env.now();
        let may_run = |job: &&Job| {
            job.state == State::Queued && job.run_at <= now && job.deadline_at.is_none_or(|deadline| deadline > now)
        };
        let first = before.values().filter(may_run).min_by_key(|job| (-job.priority, job.id)).map(|job| job.id);
        let claimed = self.bench.queue.claim(&format!("worker-{worker}")).await.unwrap();
        assert_eq!(claimed.as_ref().map(|(lease, _)| lease.job), first);
        if let Some((lease, job)) = claimed {
            assert_eq!(lease.epoch, before[&job.id].epoch + 1);
            self.leases.push(lease);
        }
    }

    /// A worker's write succeeds while it holds the job, and changes nothing otherwise.
    async fn work(&mut self, before: &BTreeMap<Uuid, Job>, deed: &Deed) {
        let (Deed::Heartbeat { lease: n }
        | Deed::Saved { lease: n, .. }
        | Deed::Succeed { lease: n }
        | Deed::Fail { lease: n, .. }
        | Deed::GiveBack { lease: n }
        | Deed::ConfirmCancel { lease: n }) = deed
        else {
            unreachable!("{deed:?} is no worker's")
        };
        let Some(lease) = pick(&self.leases, *n) else { return };
        let queue = &self.bench.queue;
        let held = before.get(&lease.job).is_some_and(|job| job.epoch == lease.epoch && job.owner.is_some());
        let standing = match deed {
            Deed::Saved { percent, .. } => queue.saved(&lease, f64::from(*percent) / 100.0).await,
            Deed::Succeed { .. } => queue.succeed(&lease, avatar()).await,
            Deed::Fail { repeat, .. } => queue.fail(&lease, JobError::new("device", "lost"), *repeat).await,
            Deed::GiveBack { .. } => queue.give_back(&lease).await,
            Deed::ConfirmCancel { .. } => queue.confirm_cancel(&lease).await,
            _ => queue.heartbeat(&lease).await,
        };
        assert_eq!(standing.unwrap() != Standing::Lost, held, "{deed:?} of {lease:?}");
        if !held && let Some(job) = before.get(&lease.job) {
            assert_eq!(queue.get(lease.job).await.unwrap().unwrap().version, job.version);
        }
    }

    async fn check(&mut self, before: &BTreeMap<Uuid, Job>, deed: &Deed) {
        let after = self.jobs().await;
        for (id, job) in &after {
            let old = before.get(id);
            let from = old.map_or(State::Queued, |old| old.state);
            assert!(may_become(from, job.state, deed), "{from:?} became {:?} by {deed:?}", job.state);
            assert!(old.is_none_or(|old| old.epoch <= job.epoch && old.version <= job.version));
            assert!(job.attempt - job.excused <= job.max_attempts, "{job:?}");
            assert_eq!(job.owner.is_some(), matches!(job.state, State::Running | State::Canceling));
            let published = self.bench.queue.avatar(*id).await.unwrap();
            assert_eq!(published.is_some(), job.state == State::Succeeded, "{:?}", job.state);
            assert!(published.is_none_or(|avatar| avatar.epoch == job.epoch));
            let seen = self.seen.entry(*id).or_default();
            if seen.last() != Some(&job.state) {
                seen.push(job.state);
            }
        }
        let positions: Vec<_> = after.values().filter_map(|job| job.queue_position).collect();
        let waiting = after.values().filter(|job| job.state == State::Queued).count();
        assert_eq!(positions.iter().sum::<u64>(), (1..=waiting as u64).sum::<u64>(), "each place is one job's");
    }

    /// With healthy workers, everything ends.
    async fn settle(&mut self) {
        for _ in 0..60 {
            if self.jobs().await.values().all(|job| job.state.is_final() && job.delete_requested_at.is_none()) {
                return;
            }
            self.act(&Deed::Pass { secs: 700 }).await;
            self.act(&Deed::Reap).await;
            self.act(&Deed::Claim { worker: 0 }).await;
            self.act(&Deed::Succeed { lease: self.leases.len().wrapping_sub(1) }).await;
        }
        panic!("jobs do not end: {:?}", self.jobs().await);
    }

    /// The stream of events told each state that was seen, in order.
    async fn check_history(&self) {
        for id in self.jobs().await.keys() {
            let events = self.bench.queue.events(*id, 0, 10_000).await.unwrap();
            let mut told = events.iter().filter_map(|event| State::from_name(event.data["state"].as_str()?));
            for state in &self.seen[id] {
                assert!(told.any(|told| told == *state), "{state:?} of {:?} was not told", self.seen[id]);
            }
        }
    }
}

fn may_become(from: State, to: State, deed: &Deed) -> bool {
    use State::*;
    from == to
        || match (from, to) {
            (Queued, Running) => matches!(deed, Deed::Claim { .. }),
            (Queued, Canceled) | (Running, Canceling) => matches!(deed, Deed::Cancel { .. } | Deed::Delete { .. }),
            (Queued, Failed) => matches!(deed, Deed::Reap),
            (Running, Succeeded) | (Canceling, Succeeded) => matches!(deed, Deed::Succeed { .. }),
            (Running, Queued | Failed) => {
                matches!(deed, Deed::Fail { .. } | Deed::Reap | Deed::WorkerDies { .. } | Deed::GiveBack { .. })
            }
            (Canceling, Canceled) => !matches!(deed, Deed::Claim { .. } | Deed::Retry { .. } | Deed::Pass { .. }),
            (Failed | Canceled, Queued) => matches!(deed, Deed::Retry { .. }),
            (Succeeded | Failed | Canceled, Expired) => matches!(deed, Deed::Reap),
            _ => false,
        }
}

/// `EFFIGY_TORTURE_CASES` histories, of up to 60 deeds each.
#[test]
fn every_history_keeps_the_rules() {
    let cases = std::env::var("EFFIGY_TORTURE_CASES").ok().and_then(|n| n.parse().ok()).unwrap_or(40);
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    let config = Config { cases, failure_persistence: None, max_shrink_iters: 200, ..Config::default() };
    proptest!(config, |(history in prop::collection::vec(deeds(), 1..60))| {
        runtime.block_on(async {
            let bench = open().await;
            let mut world = World { bench, leases: Vec::new(), ids: Vec::new(), seen: BTreeMap::new() };
            for deed in &history {
                world.act(deed).await;
            }
            world.settle().await;
            world.check_history().await;
        });
    });
}
