"""The pitch loop of five elements as it would be written without Hybrid, for benches/speed.py."""
