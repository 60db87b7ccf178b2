"""What a target sends towards the observer: shapes, eclipse, lighting."""
