"""What the aircraft pushes, as users get it: samples, subscriptions, newest values, its clock."""
