"""NASA's check cases: what they are, how they are flown, what their errors come of, how fast they fly."""
