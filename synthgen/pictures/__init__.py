"""Pictures of a dataset: contact sheets, one shot with its passes."""
