"""Results to look at elsewhere: one page that plays from the disk, and the files of other programs."""
