-- Who may use the service. A key's token is 256 random bits, shown once at its creation; only its SHA-256 is kept. A
-- plain hash is enough: nobody can guess 256 bits, so that the slowness and the salt which protect passwords would
-- protect nothing here, and a request is answered by one look into the index.
CREATE TABLE api_keys (
    id TEXT PRIMARY KEY NOT NULL,
    -- For people; `effigy keys revoke` takes it too.
    name TEXT NOT NULL,
    token_sha256 BLOB NOT NULL UNIQUE CHECK (length(token_sha256) = 32),
    -- JSON list of `read`, `write`, `metrics`, `admin`.
    scopes TEXT NOT NULL CHECK (json_valid(scopes)),

    -- Quotas, NULL for none: jobs that may wait and run at a time, bytes of inputs and results that may be kept,
    -- requests a minute. The claim passes over the jobs of a key that has max_running of them with workers.
    max_queued INTEGER CHECK (max_queued >= 0),
    max_running INTEGER CHECK (max_running >= 0),
    max_bytes INTEGER CHECK (max_bytes >= 0),
    per_minute INTEGER CHECK (per_minute > 0),

    created_at INTEGER NOT NULL,
    expires_at INTEGER,
    -- A revoked key stays, because its jobs name it.
    revoked_at INTEGER
) STRICT;

-- One living key a name, so that a name can be revoked.
CREATE UNIQUE INDEX api_keys_names ON api_keys (name) WHERE revoked_at IS NULL;

-- Whose job it is; NULL where nobody had to say who he is. Never changes. Others do not learn that the job exists.
ALTER TABLE jobs ADD COLUMN key_id TEXT REFERENCES api_keys (id);
CREATE INDEX jobs_of_key ON jobs (key_id, id) WHERE key_id IS NOT NULL;

-- Random bytes that the service signs with, by purpose. Made at first need.
CREATE TABLE secrets (
    name TEXT PRIMARY KEY NOT NULL,
    value BLOB NOT NULL CHECK (length(value) >= 32),
    created_at INTEGER NOT NULL
) STRICT;
