"""The cost-to-go around the hull to each port: solved once (`eikonal`), kept on disk, and looked up (`geodesic`)."""

from owm_envs.field.eikonal import FieldConfig
from owm_envs.field.geodesic import GeodesicField, clearance, cost_to_go, field_rows, load_field, solve_field

__all__ = ["FieldConfig", "GeodesicField", "clearance", "cost_to_go", "field_rows", "load_field", "solve_field"]
