"""The pressurised station: modules, nodes, adapters and airlocks, and what is mounted on them."""

from owm_envs.station.primitives import (
    ESTIMATE,
    EXTENT,
    PORTS,
    PUBLISHED,
    Part,
    ball,
    beam,
    box,
    module,
    rod,
    sheet,
    tube,
)

_US = (0.233, -2.602)  # x and z of the line through Harmony, Destiny and Unity
_RS = (0.233, -1.870)  # x and z of the line through Zarya and Zvezda
_LAB = (-14.939, -2.602)  # y and z of the line through Columbus, Harmony and Kibo
_NODE = (0.166, -2.602)  # y and z of the line through Quest, Unity and Tranquility
_FOLDED = "folded since 2007; size estimated from photographs"
SUN = (0.0, 41.0 / 6170.0**0.5, 67.0 / 6170.0**0.5)
"""Direction of the array wings in the y-z plane, from the quoted extents: (-25, -31) to (16, 36)."""


_FORWARD = (
    tube("pma_2_ring", "y", (-20.84, -20.30), (0.194, -3.336), 1.45, 1.45, "metal", PORTS),
    rod("pma_2", (0.194, -20.42, -3.30), (0.233, -18.62, -2.72), 1.55, "adapter", PORTS, 2.25),
    tube("pma_2_berth", "y", (-18.62, -18.35), _US, 2.3, 2.3, "berth", ESTIMATE),
    *module("harmony", "y", (-18.45, -11.25), _US, 4.4, "shield", PUBLISHED),
    tube("harmony_zenith_berth", "z", (-0.9, -0.218), (0.233, -14.939), 2.0, 2.0, "berth", PORTS),
    tube("harmony_nadir_berth", "z", (-4.985, -4.3), (0.233, -14.939), 2.0, 2.0, "berth", PORTS),
    tube("harmony_starboard_berth", "x", (-2.25, -1.6), _LAB, 2.1, 2.1, "berth", ESTIMATE),
    tube("harmony_port_berth", "x", (2.1, 2.75), _LAB, 2.1, 2.1, "berth", ESTIMATE),
    *module("destiny", "y", (-11.25, -2.75), _US, 4.3, "shield", PUBLISHED),
    box("stowage_platform_1", (2.35, 3.45), (-6.3, -4.3), (-2.2, -1.2), "equipment", "ESP-1; " + ESTIMATE),
    *module("columbus", "x", (-9.0, -2.15), _LAB, 4.4, "shield", PUBLISHED, (0.45, 0.6)),
    box("columbus_payload_frame", (-9.15, -8.75), (-15.6, -14.3), (-4.5, -0.6), "metal", EXTENT),
    box("columbus_solar", (-9.7, -8.6), (-15.6, -14.3), (-0.9, 0.3), "foil", "SOLAR, zenith; " + ESTIMATE),
    box("columbus_rapidscat", (-9.7, -8.6), (-15.6, -14.4), (-5.1, -4.2), "blanket", "RapidScat, nadir; " + ESTIMATE),
    tube("columbus_rapidscat_dish", "z", (-5.7, -5.1), (-9.2, -15.0), 0.8, 0.3, "dark", ESTIMATE),
    box("columbus_hdev", (-9.6, -9.0), (-15.2, -14.6), (-2.6, -2.0), "blanket", "HDEV; " + ESTIMATE),
)

_KIBO = (
    *module("kibo_pressurised", "x", (2.65, 13.85), _LAB, 4.4, "shield", PUBLISHED, (0.6, 0.25)),
    tube("kibo_airlock", "x", (13.85, 14.35), (-14.939, -3.6), 1.7, 1.7, "metal", ESTIMATE),
    *module("kibo_logistics", "z", (-0.55, 3.5), (6.4, -14.939), 4.4, "shield", PUBLISHED, (0.35, 0.35)),
    box("kibo_exposed_facility", (14.3, 19.9), (-17.45, -12.45), (-5.0, -2.9), "blanket", PUBLISHED),
    box("kibo_exposed_facility_mount", (13.6, 14.4), (-16.0, -13.9), (-3.9, -2.4), "metal", ESTIMATE),
    box("kibo_exposed_facility_top", (15.2, 19.3), (-16.6, -13.3), (-2.9, -1.4), "equipment", ESTIMATE),
    *(
        box(f"kibo_payload_{name}", (x, x + 0.85), (y, y + 1.85), (-4.6, -3.6), material, "payload; " + ESTIMATE)
        for name, x, y, material in (
            ("maxi", 18.9, -19.3, "foil"),
            ("hrep", 17.1, -19.3, "blanket"),
            ("icef", 15.3, -19.3, "equipment"),
            ("smiles", 18.9, -12.45, "blanket"),
            ("seda", 17.1, -12.45, "foil"),
            ("mce", 15.3, -12.45, "equipment"),
        )
    ),
    box("kibo_payload_cats", (19.9, 21.75), (-16.8, -15.9), (-4.6, -3.6), "foil", "CATS; " + ESTIMATE),
    box("kibo_payload_icsef", (19.9, 23.0), (-14.4, -13.6), (-4.6, -3.8), "equipment", EXTENT),
    box("kibo_arm_base", (13.85, 14.75), (-14.3, -13.4), (-1.3, -0.2), "arm", ESTIMATE),
    rod("kibo_arm_upper", (14.5, -13.9, -0.3), (18.2, -13.5, 0.9), 0.36, "arm", "main arm 10 m; pose estimated"),
    ball("kibo_arm_elbow", (18.2, -13.5, 0.9), 0.55, "metal", ESTIMATE),
    rod("kibo_arm_fore", (18.2, -13.5, 0.9), (15.2, -14.6, -0.6), 0.32, "arm", "main arm 10 m; pose estimated"),
    ball("kibo_arm_wrist", (15.2, -14.6, -0.6), 0.5, "metal", ESTIMATE),
)

_NODES = (
    *module("unity", "y", (-2.75, 2.75), _US, 4.4, "shield", PUBLISHED, (0.45, 0.45)),
    tube("unity_nadir_berth", "z", (-4.918, -4.2), (0.233, 0.166), 2.0, 2.0, "berth", PORTS),
    tube("unity_port_berth", "x", (2.1, 2.75), _NODE, 2.1, 2.1, "berth", ESTIMATE),
    tube("unity_starboard_berth", "x", (-2.25, -1.6), _NODE, 2.1, 2.1, "berth", ESTIMATE),
    tube("pma_1_berth", "y", (2.65, 2.95), _US, 2.3, 2.3, "berth", ESTIMATE),
    rod("pma_1", (0.233, 2.9, -2.55), (0.233, 6.15, -1.90), 2.25, "adapter", PORTS, 1.65),
    *module("tranquility", "x", (2.65, 9.35), _NODE, 4.4, "shield", PUBLISHED),
    rod("pma_3", (9.25, 0.166, -2.66), (11.2, 0.166, -3.05), 2.2, "adapter", PORTS, 1.5),
    tube("pma_3_ring", "x", (11.15, 11.7), (0.166, -3.1), 1.45, 1.45, "metal", PORTS),
    tube("cupola_berth", "z", (-5.0, -4.5), (6.6, 0.166), 2.1, 2.1, "berth", ESTIMATE),
    tube("cupola", "z", (-5.6, -4.95), (6.6, 0.166), 2.95, 2.95, "blanket", PUBLISHED),
    tube("cupola_windows", "z", (-6.35, -5.6), (6.6, 0.166), 1.7, 2.9, "metal", PUBLISHED),
    tube("cupola_window_nadir", "z", (-6.45, -6.35), (6.6, 0.166), 0.85, 1.5, "glass", PUBLISHED),
    tube("leonardo_berth", "y", (-2.3, -1.7), (6.6, -2.602), 2.1, 2.1, "berth", ESTIMATE),
    *module("leonardo", "y", (-8.85, -2.2), (6.6, -2.602), 4.5, "shield", PUBLISHED),
    *module("quest_equipment_lock", "x", (-5.3, -2.15), _NODE, 4.0, "shield", PUBLISHED, (0.6, 0.5)),
    tube("quest_crew_lock", "x", (-7.7, -5.1), _NODE, 2.0, 2.0, "shield", PUBLISHED),
    *(
        beam(
            f"quest_tank_{name}",
            (x, 0.166 + y, -2.602 + z),
            (x, 0.166 + 1.36 * y, -2.602 + 1.36 * z),
            1.25,
            1.25,
            "blanket",
            "oxygen and nitrogen tanks; " + ESTIMATE,
        )
        for name, x, y, z in (
            ("forward_zenith", -3.0, -1.35, 1.35),
            ("aft_zenith", -3.0, 1.35, 1.35),
            ("aft_zenith_2", -4.4, 1.35, 1.35),
            ("forward_zenith_2", -4.4, -1.35, 1.35),
        )
    ),
    box("stowage_platform_2", (-7.3, -4.1), (-3.5, -3.1), (-3.1, -0.3), "metal", "ESP-2; " + ESTIMATE),
    box("stowage_platform_2_units", (-7.0, -4.5), (-4.2, -3.5), (-2.8, -0.6), "equipment", "ESP-2; " + ESTIMATE),
    beam("stowage_platform_2_mount", (-4.9, -3.1, -1.9), (-4.9, -1.6, -2.3), 0.4, 0.4, "metal", ESTIMATE),
    box("z1_truss", (-1.6, 2.1), (-1.6, 1.9), (-0.6, 3.6), "truss", PUBLISHED),
    box("z1_gyroscopes", (-1.3, 1.8), (1.9, 3.1), (0.6, 3.2), "equipment", ESTIMATE),
    rod("z1_antenna_boom", (0.2, 0.5, 3.6), (0.2, 0.5, 6.4), 0.25, "metal", ESTIMATE),
    rod(
        "z1_antenna_dish",
        (0.2, 0.5, 6.9),
        (0.2, 0.35, 6.4),
        1.83,
        "white",
        "Ku-band dish 1.83 m; place estimated",
        0.5,
    ),
    rod("z1_antenna_boom_2", (1.5, 0.9, 3.6), (1.9, 1.2, 5.4), 0.2, "metal", ESTIMATE),
    rod(
        "z1_antenna_dish_2",
        (1.9, 1.2, 5.9),
        (1.9, 1.1, 5.4),
        1.83,
        "white",
        "Ku-band dish 1.83 m; place estimated",
        0.5,
    ),
)


def _zvezda_array(label: str, inboard: float, outboard: float) -> tuple[Part, ...]:
    """One wing of Zvezda, turned to the Sun like the large arrays."""
    start, end = ((x, 27.6, -1.870) for x in (inboard, outboard))
    return (
        rod(f"zvezda_array_{label}_mast", start, end, 0.25, "metal", ESTIMATE),
        sheet(f"zvezda_array_{label}", start, end, 3.4, 0.06, "array_blue", "29.7 m tip to tip; chord estimated", SUN),
    )


_RUSSIAN = (
    tube("zarya_adapter", "y", (6.05, 8.05), _RS, 1.9, 2.3, "russian", PUBLISHED),
    tube("zarya_cone", "y", (8.05, 9.0), _RS, 2.4, 4.1, "russian", PUBLISHED),
    tube("zarya_body", "y", (9.0, 16.6), _RS, 4.1, 4.1, "russian", PUBLISHED),
    tube("zarya_aft_cone", "y", (16.6, 17.5), _RS, 4.1, 2.7, "russian", PUBLISHED),
    tube("zarya_aft", "y", (17.5, 19.1), _RS, 2.5, 2.2, "russian", PUBLISHED),
    box("zarya_array_port", (2.25, 4.4), (11.9, 14.7), (-2.6, -1.1), "array_blue", _FOLDED),
    box("zarya_array_starboard", (-3.93, -1.78), (11.9, 14.7), (-2.6, -1.1), "array_blue", _FOLDED),
    ball("zvezda_transfer", (0.233, 20.129, -1.870), 2.3, "russian", PUBLISHED),
    tube("zvezda_transfer_neck", "y", (20.6, 21.5), _RS, 2.0, 2.9, "russian", PUBLISHED),
    tube("zvezda_small", "y", (21.5, 24.8), _RS, 2.9, 2.9, "russian", PUBLISHED),
    tube("zvezda_cone", "y", (24.8, 26.0), _RS, 2.9, 4.15, "russian", PUBLISHED),
    tube("zvezda_large", "y", (26.0, 31.6), _RS, 4.15, 4.15, "russian", PUBLISHED),
    tube("zvezda_aft", "y", (31.6, 32.0), _RS, 3.9, 2.6, "russian", ESTIMATE),
    tube("zvezda_drogue", "y", (31.9, 32.55), _RS, 1.9, 1.45, "metal", PORTS),
    *_zvezda_array("port", 2.3, 15.1),
    *_zvezda_array("starboard", -14.6, -1.84),
    rod("zvezda_lira_mast", (0.233, 31.2, 0.1), (0.233, 31.9, 1.5), 0.15, "metal", ESTIMATE),
    rod("zvezda_lira", (0.233, 31.9, 1.5), (0.233, 32.05, 1.75), 1.1, "white", "Lira antenna; " + ESTIMATE, 0.4),
    tube("poisk_neck", "z", (-1.0, -0.3), (0.233, 20.129), 1.7, 2.2, "russian_white", ESTIMATE),
    tube("poisk", "z", (-0.3, 2.5), (0.233, 20.129), 2.55, 2.55, "russian_white", PUBLISHED),
    tube("poisk_cone", "z", (2.5, 3.1), (0.233, 20.129), 2.5, 1.6, "russian_white", ESTIMATE),
    tube("poisk_drogue", "z", (3.1, 3.555), (0.233, 20.129), 1.45, 1.45, "metal", PORTS),
    tube("pirs_neck", "z", (-3.6, -2.75), (0.233, 20.129), 2.2, 1.7, "russian", ESTIMATE),
    tube("pirs", "z", (-6.3, -3.6), (0.233, 20.129), 2.55, 2.55, "russian", PUBLISHED),
    tube("pirs_cone", "z", (-6.85, -6.3), (0.233, 20.129), 1.6, 2.5, "russian", ESTIMATE),
    tube("pirs_drogue", "z", (-7.29, -6.85), (0.233, 20.129), 1.45, 1.45, "metal", PORTS),
    tube("rassvet_neck", "z", (-4.0, -2.6), (0.24, 7.161), 2.35, 1.7, "russian_white", ESTIMATE),
    tube("rassvet", "z", (-8.2, -4.0), (0.24, 7.161), 2.35, 2.35, "russian_white", PUBLISHED),
    tube("rassvet_cone", "z", (-8.85, -8.2), (0.24, 7.161), 1.6, 2.3, "russian_white", ESTIMATE),
    tube("rassvet_drogue", "z", (-9.267, -8.85), (0.24, 7.161), 1.45, 1.45, "metal", PORTS),
    tube("rassvet_mlm_airlock", "z", (-7.4, -5.7), (2.05, 7.161), 1.2, 1.2, "blanket", "spare airlock; " + ESTIMATE),
    sheet(
        "rassvet_mlm_radiator",
        (0.24, 8.6, -8.0),
        (0.24, 8.6, -4.4),
        2.0,
        0.25,
        "radiator",
        "spare radiator; " + ESTIMATE,
    ),
    rod("rassvet_era_elbow", (-1.15, 7.161, -7.6), (-1.15, 7.161, -5.6), 0.35, "arm", "spare elbow; " + ESTIMATE),
    rod("strela_1_base", (1.3, 20.129, 1.4), (1.9, 20.129, 1.4), 0.5, "metal", "crane on Poisk; " + ESTIMATE),
    rod("strela_1_boom", (1.9, 20.129, 1.4), (2.6, 26.4, 1.1), 0.22, "metal", "crane, stowed; pose estimated"),
    rod("strela_2_base", (-1.5, 10.0, -0.4), (-1.9, 10.0, -0.1), 0.5, "metal", "crane on Zarya; " + ESTIMATE),
    rod("strela_2_boom", (-1.9, 10.0, -0.1), (-1.9, 16.3, 0.3), 0.22, "metal", "crane, stowed; pose estimated"),
)

MODULES: tuple[Part, ...] = (*_FORWARD, *_KIBO, *_NODES, *_RUSSIAN)
