-- A page of the jobs in one state is read from its end, newest first: no sorting of all that have ever succeeded.
DROP INDEX jobs_state;
CREATE INDEX jobs_state ON jobs (state, id);
