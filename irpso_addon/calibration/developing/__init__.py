"""Photographs developed to a capture: corrections measured, kept for later captures, and images written."""
