"""The command `stereo-slam`: one file a group of commands."""
