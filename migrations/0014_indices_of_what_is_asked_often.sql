-- What the service asks often is answered from the few rows that it is about, however long the history has become.

-- Jobs that workers hold: the reaper asks for their owners every two seconds, and the claim counts a key's.
CREATE INDEX jobs_held ON jobs (key_id, owner) WHERE owner IS NOT NULL;
-- Messages that are over: every attempt at another one removes those of long ago.
CREATE INDEX deliveries_over ON deliveries (created_at) WHERE next_at IS NULL;
