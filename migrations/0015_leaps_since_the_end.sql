-- By how much the wall clock has leapt since the job's end (0013). Retention counts from `finished_at` plus this: so another
-- retention can be applied to jobs that have ended, and a clock that was wrong at their end expires none of them.
ALTER TABLE jobs ADD COLUMN leapt_ms INTEGER NOT NULL DEFAULT 0;
-- What leaps have done so far stands in `expires_at` alone: where that is not as far from the end as in most jobs, the rest counts as
-- leapt. It may be a retention of before, which then stays what it was.
UPDATE jobs SET leapt_ms = expires_at - finished_at - (
    SELECT expires_at - finished_at FROM jobs WHERE expires_at IS NOT NULL AND finished_at IS NOT NULL
    GROUP BY expires_at - finished_at ORDER BY count(*) DESC LIMIT 1
) WHERE expires_at IS NOT NULL AND finished_at IS NOT NULL;
