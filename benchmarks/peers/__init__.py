"""Peer methods, written from their papers or taken from their libraries, that the benchmarks compare with."""
