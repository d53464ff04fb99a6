-- How the wall clock stood to the time since the machine's start, which nobody sets. When the two disagree, the wall
-- clock has leapt, and all times that are still to come are moved with it (one row).
CREATE TABLE clock (
    id INTEGER PRIMARY KEY CHECK (id = 1),
    -- The machine's start that it was.
    boot TEXT NOT NULL,
    -- Wall clock minus time since that start, and the wall clock when the row was written.
    offset_ms INTEGER NOT NULL,
    seen_at INTEGER NOT NULL
) STRICT;
