-- Pictures of the avatar as it emerges. Names the newest file in the job's folder `previews`, which the worker writes
-- before it writes the name; NULL before the first picture and after the files were removed.
ALTER TABLE jobs ADD COLUMN preview TEXT;

-- A third kind of event, `preview`: there is a new picture. SQLite cannot change a CHECK, so the table is made anew; its
-- ids go on where they were, also behind events that are gone.
CREATE TABLE events_anew (
    id INTEGER PRIMARY KEY AUTOINCREMENT,
    job_id TEXT NOT NULL REFERENCES jobs (id) ON DELETE CASCADE,
    at INTEGER NOT NULL,
    kind TEXT NOT NULL CHECK (kind IN ('state', 'progress', 'preview')),
    data TEXT NOT NULL CHECK (json_valid(data))
) STRICT;

INSERT INTO events_anew (id, job_id, at, kind, data) SELECT id, job_id, at, kind, data FROM events;
DELETE FROM sqlite_sequence WHERE name = 'events_anew';
INSERT INTO sqlite_sequence (name, seq) SELECT 'events_anew', seq FROM sqlite_sequence WHERE name = 'events';
DROP TABLE events;
ALTER TABLE events_anew RENAME TO events;
CREATE INDEX events_of_job ON events (job_id, id);
