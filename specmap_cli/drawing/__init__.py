"""Pictures of finished maps, of predicted labels, of confusions and of split tests."""
