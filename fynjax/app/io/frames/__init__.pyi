from ._read import read_frames as read_frames
