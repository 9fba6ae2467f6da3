"""Folders that may lie elsewhere: in a bucket, on another machine, or on a disk here."""
