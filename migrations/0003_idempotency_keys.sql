-- Keys that clients gave with a job (`Idempotency-Key`), each with the answer that it got: whoever sends the same job
-- again under the same key gets that answer again, and no second job. Inserted in the transaction that queues the job;
-- removed a day later, whatever became of the job meanwhile.
CREATE TABLE idempotency_keys (
    -- The id of the API key that it came with, if one did, a slash, the client's text: clients never meet.
    key TEXT PRIMARY KEY NOT NULL CHECK (length(key) BETWEEN 2 AND 300),
    -- SHA-256 (lower-case hex) over the names and contents of the parts and the options: another request under the same
    -- key is refused.
    fingerprint TEXT NOT NULL CHECK (length(fingerprint) = 64),
    -- The body of the answer, as it was sent.
    answer TEXT NOT NULL CHECK (json_valid(answer)),
    created_at INTEGER NOT NULL
) STRICT, WITHOUT ROWID;

CREATE INDEX idempotency_keys_age ON idempotency_keys (created_at);
