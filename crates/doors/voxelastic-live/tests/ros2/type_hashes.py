"""The hashes of types (REP 2016) by rosbags. As a program: the definition of voxelastic_msgs/srv/GetDistances, then names."""
import sys

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

store = get_typestore(Stores.ROS2_JAZZY)
octomap = "std_msgs/Header header\nbool binary\nstring id\nfloat64 resolution\nint8[] data\n"
store.register(get_types_from_msg(octomap, "octomap_msgs/msg/Octomap"))
update = "std_msgs/Header header\nint32 x\nint32 y\nuint32 width\nuint32 height\nint8[] data\n"
store.register(get_types_from_msg(update, "map_msgs/msg/OccupancyGridUpdate"))
# In IDL, a char is a byte.
info = "service_msgs/msg/ServiceEventInfo"
gid = ("client_gid", (Nodetype.ARRAY, ((Nodetype.BASE, ("uint8", 0)), 16)))
store.fielddefs[info] = (store.fielddefs[info][0], [gid if name == "client_gid" else (name, kind) for name, kind in store.fielddefs[info][1]])

done, parameters = "bool success\nstring message\n", "rcl_interfaces/Parameter[] parameters\n"
SERVICES = {
    "std_srvs/srv/Trigger": "\n---\n" + done,
    "std_srvs/srv/SetBool": "bool data\n---\n" + done,
    "nav_msgs/srv/GetPlan": "geometry_msgs/PoseStamped start\ngeometry_msgs/PoseStamped goal\nfloat32 tolerance\n---\nnav_msgs/Path plan\n",
    "nav_msgs/srv/GetMap": "\n---\nnav_msgs/OccupancyGrid map\n",
    "nav_msgs/srv/LoadMap": "string map_url\n---\nnav_msgs/OccupancyGrid map\nuint8 result\n",
    "lifecycle_msgs/srv/GetState": "\n---\nlifecycle_msgs/State current_state\n",
    "lifecycle_msgs/srv/ChangeState": "lifecycle_msgs/Transition transition\n---\nbool success\n",
    "lifecycle_msgs/srv/GetAvailableStates": "\n---\nlifecycle_msgs/State[] available_states\n",
    "lifecycle_msgs/srv/GetAvailableTransitions": "\n---\nlifecycle_msgs/TransitionDescription[] available_transitions\n",
    "rcl_interfaces/srv/ListParameters": "string[] prefixes\nuint64 depth\n---\nrcl_interfaces/ListParametersResult result\n",
    "rcl_interfaces/srv/GetParameters": "string[] names\n---\nrcl_interfaces/ParameterValue[] values\n",
    "rcl_interfaces/srv/GetParameterTypes": "string[] names\n---\nuint8[] types\n",
    "rcl_interfaces/srv/DescribeParameters": "string[] names\n---\nrcl_interfaces/ParameterDescriptor[] descriptors\n",
    "rcl_interfaces/srv/SetParameters": parameters + "---\nrcl_interfaces/SetParametersResult[] results\n",
    "rcl_interfaces/srv/SetParametersAtomically": parameters + "---\nrcl_interfaces/SetParametersResult result\n",
}


def of_service(name):
    """A service is a structure of its request, its response, and the event that tells about a call."""
    for part, text in zip(("_Request", "_Response"), SERVICES[name].split("---\n")):
        store.fielddefs[name + part] = next(iter(get_types_from_msg(text, name + part).values()))
    at_most_one = lambda part: (Nodetype.SEQUENCE, ((Nodetype.NAME, name + part), 1))
    event = [("info", (Nodetype.NAME, info)), ("request", at_most_one("_Request")), ("response", at_most_one("_Response"))]
    store.fielddefs[name + "_Event"] = ([], event)
    store.fielddefs[name] = ([], [(f"{part}_message", (Nodetype.NAME, f"{name}_{part.title()}")) for part in ("request", "response", "event")])
    return store.hash_rihs01(name)


def hash_of(name):
    return of_service(name) if "/srv/" in name else store.hash_rihs01(name)


if __name__ == "__main__":
    SERVICES["voxelastic_msgs/srv/GetDistances"] = sys.argv[1]
    for name in sys.argv[2:]:
        print(hash_of(name))
