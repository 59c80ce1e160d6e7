"""Engines: advance the analog state from event to event and do what each event asks."""
