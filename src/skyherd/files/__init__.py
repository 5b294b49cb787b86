"""Files: atomic writing; reading and writing of pictures and videos."""
