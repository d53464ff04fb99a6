-- By how much the wall clock has leapt since the job's end (0013). Retention counts from `finished_at` plus this: so another
-- retention can be applied to jobs that have ended, and a clock that was wrong at their end expires none of them.
ALTER TABLE jobs ADD COLUMN leapt_ms INTEGER NOT NULL DEFAULT 0;
