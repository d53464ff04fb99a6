-- Whom to tell when a job changes its state. Like a job, a webhook belongs to the key that made it, and hears of that
-- key's jobs only.
CREATE TABLE webhooks (
    id TEXT PRIMARY KEY NOT NULL,
    key_id TEXT REFERENCES api_keys (id),
    url TEXT NOT NULL,
    -- What deliveries are signed with; the receiver has it too, so it cannot be kept as a hash.
    secret BLOB NOT NULL CHECK (length(secret) >= 24),
    -- JSON list of `job.<state>`.
    events TEXT NOT NULL CHECK (json_valid(events)),
    created_at INTEGER NOT NULL,
    -- Set when the receiver answered 410, which says: never again.
    disabled_at INTEGER
) STRICT;

-- A message to a receiver. Written in the transaction that changes the job's state, so that no change goes untold and
-- none is told that did not happen; tried until it is taken, refused for good, or its last attempt has failed.
CREATE TABLE deliveries (
    -- `msg_…`, the same with each attempt: by it the receiver tells a repetition.
    id TEXT PRIMARY KEY NOT NULL,
    webhook_id TEXT NOT NULL REFERENCES webhooks (id) ON DELETE CASCADE,
    payload TEXT NOT NULL CHECK (json_valid(payload)),
    created_at INTEGER NOT NULL,
    -- Attempts made, and when the next is due; NULL when there will be none.
    attempts INTEGER NOT NULL DEFAULT 0,
    next_at INTEGER,
    delivered_at INTEGER,
    -- What came of the last attempt.
    last_status INTEGER,
    last_error TEXT,
    CHECK (delivered_at IS NULL OR next_at IS NULL)
) STRICT;

CREATE INDEX deliveries_due ON deliveries (next_at) WHERE next_at IS NOT NULL;
CREATE INDEX deliveries_of ON deliveries (webhook_id, created_at);
