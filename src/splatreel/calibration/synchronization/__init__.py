"""Synchronization of videos by sound, by what they show, or by timecode."""
