#!/usr/bin/env bash
# Builds the package voxelastic_msgs with colcon, and a program in C++ that uses it: crates/doors/voxelastic-live/ros/check.sh [FOLDER]
#
# Where there is ROS 2, this is what a workspace does. This is for machines without it that have Debian's packages of its build tools: colcon, python3-colcon-cmake,
# python3-colcon-ros, ament-cmake, rosidl-core, rosidl-generator-c-cpp and the headers librosidl-*-dev. Debian has no geometry_msgs and no rosidl_default_*: stand-ins with the
# two messages that are needed take their place. Works in FOLDER, else in a temporary one.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
if [ $# -gt 0 ]; then folder=$1; else folder=$(mktemp -d) && trap 'rm -rf "$folder"' EXIT; fi
# Debian's tools work with Debian's Python.
export PATH=/usr/bin:/bin
mkdir -p "$folder/src"
cd "$folder"

package() {
    mkdir -p "src/$1"
    cat >"src/$1/package.xml" <<END
<?xml version="1.0"?>
<package format="3"><name>$1</name><version>1.0.0</version><description>Stand-in</description><maintainer email="nobody@example.com">Nobody</maintainer><license>MIT</license>
<buildtool_depend>ament_cmake</buildtool_depend>$2<export><build_type>ament_cmake</build_type></export></package>
END
    printf 'cmake_minimum_required(VERSION 3.8)\nproject(%s)\nfind_package(ament_cmake REQUIRED)\n%s\nament_package()\n' "$1" "$3" >"src/$1/CMakeLists.txt"
}

generators="rosidl_cmake rosidl_generator_c rosidl_generator_cpp rosidl_typesupport_introspection_c rosidl_typesupport_introspection_cpp"
package rosidl_default_generators "" "ament_export_dependencies($generators)"
package rosidl_default_runtime "" ""
package geometry_msgs "<buildtool_depend>rosidl_default_generators</buildtool_depend><member_of_group>rosidl_interface_packages</member_of_group>" \
    'find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} "msg/Point.msg" "msg/Vector3.msg")'
mkdir -p src/geometry_msgs/msg
for message in Point Vector3; do printf 'float64 x\nfloat64 y\nfloat64 z\n' >"src/geometry_msgs/msg/$message.msg"; done
cp -r "$here/voxelastic_msgs" src/

colcon build --executor sequential --cmake-args -DPython3_EXECUTABLE=/usr/bin/python3

cat >use.cpp <<'END'
#include <cstdio>
#include <type_traits>
#include "voxelastic_msgs/srv/get_distances.hpp"
using voxelastic_msgs::srv::GetDistances;
static_assert(std::is_same_v<decltype(GetDistances::Response::distances)::value_type, double>);
int main() {
  GetDistances::Request request;
  request.points.resize(2);
  request.points[1].x = 1.5;
  GetDistances::Response response;
  response.success = true;
  response.known = {true, false};
  response.distances = {0.5, 0.0};
  response.gradients.resize(request.points.size());
  std::printf("%zu points, %zu distances, %zu gradients\n", request.points.size(), response.distances.size(), response.gradients.size());
}
END
includes=()
for name in geometry_msgs voxelastic_msgs; do includes+=("-Iinstall/$name/include/$name" "-Iinstall/$name/include"); done
for headers in /usr/include/rosidl_*; do includes+=("-I$headers"); done
g++ -std=c++17 "${includes[@]}" use.cpp -o use
test "$(./use)" = "2 points, 2 distances, 2 gradients"
printf 'voxelastic_msgs builds, and a program uses it\n'
