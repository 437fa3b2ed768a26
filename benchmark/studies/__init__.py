"""Accuracy and its cost in time: studies that users run on their own scenes and machines (`gof study`)."""
