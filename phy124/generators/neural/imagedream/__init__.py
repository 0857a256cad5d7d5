"""ImageDream: four consistent views of the object in a picture (Wang & Shi 2023)."""
