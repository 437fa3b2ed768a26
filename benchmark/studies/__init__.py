"""What accuracy costs in time: studies that users run on their own scenes and machines (`gof study`)."""
