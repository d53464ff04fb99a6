-- The domain in one page. Times are milliseconds since 1970 (UTC); ids are UUIDv7, so their text sorts by creation.
-- Files are not here: a job's folder in the store holds its inputs, its checkpoints and its results by epoch.

-- A job: one uploaded clip on its way to an avatar.
--
--            claim                finish
--   queued ─────────► running ─────────────► succeeded ─┐ retention
--     ▲  │ cancel       │  │ cancel   give up           ├──────────► expired
--     │  └──► canceled  │  └► canceling ──► canceled ───┤
--     │                 └───────────────► failed ───────┘
--     └── a worker gave the attempt back, failed in a way worth repeating, or its lease ran out;
--         or a user asked for a retry of a failed or canceled job.
--
-- Who moves a job: the API creates it (queued), cancels and retries it; the worker that claimed it renews the lease and
-- ends it; the reaper takes back leases that ran out and expires what retention has ended.
CREATE TABLE jobs (
    id TEXT PRIMARY KEY NOT NULL,

    state TEXT NOT NULL CHECK (
        state IN ('queued', 'running', 'canceling', 'succeeded', 'canceled', 'failed', 'expired')
    ),

    -- What was asked for (JSON, `JobOptions`) and which parts came (JSON, part name -> {bytes}). Never change.
    options TEXT NOT NULL CHECK (json_valid(options)),
    inputs TEXT NOT NULL CHECK (json_valid(inputs)),
    -- What the inspection of the upload found: frames, size, frame rate (JSON). Never changes.
    clip TEXT NOT NULL CHECK (json_valid(clip)),

    -- The queue's order: higher priority first, then the older job. A job is not claimed before `run_at`: its creation,
    -- later the end of a backoff.
    priority INTEGER NOT NULL DEFAULT 0,
    created_at INTEGER NOT NULL,
    run_at INTEGER NOT NULL,

    -- Counted at the claim, so that a job which kills its process is counted too. Compared with max_attempts when the
    -- attempt ends badly. A shutdown gives the attempt back; a user's retry starts again from 0.
    attempt INTEGER NOT NULL DEFAULT 0 CHECK (attempt >= 0),
    max_attempts INTEGER NOT NULL CHECK (max_attempts > 0),

    -- The lease. `epoch` grows by one with each claim and never falls: every write of a worker names the epoch that it
    -- was given, and a write with another epoch changes nothing. `owner` is the worker's id.
    epoch INTEGER NOT NULL DEFAULT 0 CHECK (epoch >= 0),
    owner TEXT,
    lease_until INTEGER,

    -- Progress, written by the worker at most about once a second; survives the end of the attempt for the reader.
    stage TEXT,
    step INTEGER NOT NULL DEFAULT 0,
    steps INTEGER NOT NULL DEFAULT 0,
    progress REAL NOT NULL DEFAULT 0 CHECK (progress BETWEEN 0 AND 1),
    eta_secs REAL,
    losses TEXT NOT NULL DEFAULT '{}' CHECK (json_valid(losses)),

    -- First claim ever; the user's wish to cancel (the API); the end (worker, reaper, or the API for a queued job);
    -- the user's wish to delete a job that a worker still holds (the API); the end of retention, set at the end of
    -- the job where retention is configured.
    started_at INTEGER,
    cancel_requested_at INTEGER,
    finished_at INTEGER,
    delete_requested_at INTEGER,
    expires_at INTEGER,
    -- The last change of any column, and how many there were: the ETag of the job.
    updated_at INTEGER NOT NULL,
    version INTEGER NOT NULL DEFAULT 1,

    -- Why the last attempt ended badly (JSON, `JobError`). Kept while a repeated job waits, cleared by a user's retry.
    error TEXT CHECK (error IS NULL OR json_valid(error)),

    -- A lease exists exactly while a worker has the job.
    CHECK ((state IN ('running', 'canceling')) = (owner IS NOT NULL)),
    CHECK ((state IN ('running', 'canceling')) = (lease_until IS NOT NULL)),
    -- Whoever has or had a worker was claimed.
    CHECK (state NOT IN ('running', 'canceling', 'succeeded') OR (started_at IS NOT NULL AND epoch > 0)),
    -- An end has a time, and only an end has.
    CHECK ((state IN ('succeeded', 'canceled', 'failed', 'expired')) = (finished_at IS NOT NULL)),
    -- Only a wish makes a job canceling or canceled.
    CHECK (state NOT IN ('canceling', 'canceled') OR cancel_requested_at IS NOT NULL),
    CHECK (state NOT IN ('queued', 'running') OR cancel_requested_at IS NULL),
    -- Whoever failed says why.
    CHECK (state != 'failed' OR error IS NOT NULL),
    -- Results stay for ever or until a time after the end.
    CHECK (expires_at IS NULL OR finished_at IS NOT NULL)
) STRICT;

-- The claim reads this from its start; the queue position counts on it.
CREATE INDEX jobs_queue ON jobs (priority DESC, id) WHERE state = 'queued';
-- The reaper's three questions.
CREATE INDEX jobs_leases ON jobs (lease_until) WHERE lease_until IS NOT NULL;
CREATE INDEX jobs_expiry ON jobs (expires_at) WHERE expires_at IS NOT NULL AND state != 'expired';
CREATE INDEX jobs_deletion ON jobs (delete_requested_at) WHERE delete_requested_at IS NOT NULL;
CREATE INDEX jobs_state ON jobs (state);

-- What happened to a job, in order, for readers of its event stream: `state` at every change of state (written in the
-- transaction that changes it), `progress` with every progress that was written. Ids grow and are never used again, so
-- a reader that names the last id it saw misses nothing.
CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    at INTEGER NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('state', 'progress')),
    data TEXT NOT NULL CHECK (json_valid(data))
) STRICT;

CREATE INDEX events_of_job ON events (job_id, id);

-- Time spent in each stage by the attempts of a job, added by its worker when a stage ends.
CREATE TABLE stage_times (
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    stage TEXT NOT NULL,
    secs REAL NOT NULL CHECK (secs >= 0),
    PRIMARY KEY (job_id, stage)
) STRICT, WITHOUT ROWID;

-- An avatar: the result of one succeeded job, whose id it carries, so that a job can never publish twice. Inserted in
-- the transaction that ends the job; deleted with the job, or when retention ends.
CREATE TABLE avatars (
    id TEXT PRIMARY KEY NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    -- The epoch that made it: its files lie in the results folder of this number.
    epoch INTEGER NOT NULL CHECK (epoch > 0),
    body TEXT NOT NULL,
    frames INTEGER NOT NULL CHECK (frames > 0),
    -- The capture's camera and the fit's figures (JSON).
    camera TEXT NOT NULL CHECK (json_valid(camera)),
    metrics TEXT NOT NULL CHECK (json_valid(metrics)),
    created_at INTEGER NOT NULL
) STRICT;

-- The files of an avatar as they were published. `sha256` (lower-case hex) is the file's strong ETag.
CREATE TABLE avatar_files (
    avatar_id TEXT NOT NULL REFERENCES avatars (id) ON DELETE CASCADE,
    name TEXT NOT NULL,
    bytes INTEGER NOT NULL CHECK (bytes >= 0),
    sha256 TEXT NOT NULL CHECK (length(sha256) = 64),
    PRIMARY KEY (avatar_id, name)
) STRICT, WITHOUT ROWID;
