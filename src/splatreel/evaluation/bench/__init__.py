"""Measurements that only the `bench` commands use."""
