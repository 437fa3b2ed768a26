"""Videos and pictures as they are: what a file says, lenses, where fire is in a picture."""
