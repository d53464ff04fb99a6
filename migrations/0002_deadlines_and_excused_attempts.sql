-- When a job must have ended (its creation, or its retry, plus the option `deadline_secs`). The reaper fails a queued or
-- running job that has passed it; nobody claims such a job.
ALTER TABLE jobs ADD COLUMN deadline_at INTEGER;

-- How far the job's checkpoints have come, of the whole job (0 to 1), and how far they had come when the present
-- attempt was claimed. Told by the worker after each checkpoint that it wrote; never falls.
ALTER TABLE jobs ADD COLUMN saved REAL NOT NULL DEFAULT 0 CHECK (saved BETWEEN 0 AND 1);
ALTER TABLE jobs ADD COLUMN saved_at_claim REAL NOT NULL DEFAULT 0 CHECK (saved_at_claim BETWEEN 0 AND 1);

-- Attempts that do not count against max_attempts: a hard kill (the process died, hung or went silent) ended them after
-- the checkpoint had moved on. Each one moved the job nearer to its end, so their number is bounded. A job fails when
-- attempt - excused has reached max_attempts: one that kills its process without getting anywhere is ended by that.
ALTER TABLE jobs ADD COLUMN excused INTEGER NOT NULL DEFAULT 0 CHECK (excused BETWEEN 0 AND attempt);

-- The reaper's fourth question.
CREATE INDEX jobs_deadline ON jobs (deadline_at) WHERE deadline_at IS NOT NULL AND finished_at IS NULL;
