// A robot on Fast DDS, `robot DOMAIN`: it drives in circles through an empty room until it has seen all that it waits for, and says that as JSON. Positions are in
// metres; the room is 10 x 8 x 3 m, its floor at zero, and the odometry, whose frame the map has, is right.
#include "rosPubSubTypes.h"
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>
#include <fastdds/rtps/transport/UDPv4TransportDescriptor.h>
#include <thread>

using namespace eprosima::fastdds::dds;
using namespace geometry_msgs::msg::dds_;
using nav_msgs::msg::dds_::OccupancyGrid_;
using nav_msgs::msg::dds_::Odometry_;
using sensor_msgs::msg::dds_::PointCloud2_;
using sensor_msgs::msg::dds_::PointField_;
using tf2_msgs::msg::dds_::TFMessage_;

constexpr double LOW[3] = {-5, -4, 0}, HIGH[3] = {5, 4, 3}, LIDAR = 0.6;
constexpr int ROWS = 32, COLUMNS = 512;

// Quality of service as rmw_fastrtps has it for these topics.
template <class Type> Topic *topic(DomainParticipant *participant, const char *name) {
    TypeSupport type(new Type());
    type.register_type(participant);
    return participant->create_topic(name, type.get_type_name(), TOPIC_QOS_DEFAULT);
}

template <class Type> DataWriter *writer(DomainParticipant *participant, const char *name, bool latched, bool reliable) {
    DataWriterQos qos = DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = reliable ? RELIABLE_RELIABILITY_QOS : BEST_EFFORT_RELIABILITY_QOS;
    qos.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    qos.publish_mode().kind = ASYNCHRONOUS_PUBLISH_MODE;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    return participant->create_publisher(PUBLISHER_QOS_DEFAULT)->create_datawriter(topic<Type>(participant, name), qos);
}

template <class Type> DataReader *reader(DomainParticipant *participant, const char *name, bool latched) {
    DataReaderQos qos = DATAREADER_QOS_DEFAULT;
    qos.reliability().kind = RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = latched ? TRANSIENT_LOCAL_DURABILITY_QOS : VOLATILE_DURABILITY_QOS;
    qos.history().depth = 100;
    qos.endpoint().history_memory_policy = eprosima::fastrtps::rtps::PREALLOCATED_WITH_REALLOC_MEMORY_MODE;
    return participant->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(topic<Type>(participant, name), qos);
}

template <class Message, class Use> void take(DataReader *reader, Use use) {
    SampleInfo info;
    for (Message message; reader->take_next_sample(&message, &info) == ReturnCode_t::RETCODE_OK;)
        if (info.valid_data) use(message);
}

std_msgs::msg::dds_::Header_ header(double seconds, const char *frame) {
    std_msgs::msg::dds_::Header_ header;
    header.stamp().sec(static_cast<int32_t>(seconds));
    header.stamp().nanosec(static_cast<uint32_t>((seconds - std::floor(seconds)) * 1e9));
    header.frame_id(frame);
    return header;
}

// What a lidar at (x, y) sees that looks in a direction.
PointCloud2_ cloud(double now, double x, double y, double yaw) {
    std::vector<float> points;
    for (int row = 0; row < ROWS; row++)
        for (int column = 0; column < COLUMNS; column++) {
            double up = (-22.5 + 45.0 * row / (ROWS - 1)) * M_PI / 180, about = 2 * M_PI * column / COLUMNS, range = 1e9;
            double ray[3] = {std::cos(up) * std::cos(about + yaw), std::cos(up) * std::sin(about + yaw), std::sin(up)}, from[3] = {x, y, LIDAR};
            for (int n = 0; n < 3; n++)
                if (ray[n] != 0) range = std::min(range, ((ray[n] > 0 ? HIGH[n] : LOW[n]) - from[n]) / ray[n]);
            for (double c : {std::cos(up) * std::cos(about), std::cos(up) * std::sin(about), std::sin(up)}) points.push_back(static_cast<float>(range * c));
        }
    PointCloud2_ cloud;
    cloud.header(header(now, "lidar"));
    cloud.height(ROWS);
    cloud.width(COLUMNS);
    cloud.point_step(12);
    cloud.row_step(12 * COLUMNS);
    cloud.is_dense(true);
    for (int n = 0; n < 3; n++) {
        PointField_ field;
        field.name(std::string(1, "xyz"[n]));
        field.offset(4 * n);
        field.datatype(7);
        field.count(1);
        cloud.fields().push_back(field);
    }
    cloud.data().resize(4 * points.size());
    std::memcpy(cloud.data().data(), points.data(), cloud.data().size());
    return cloud;
}

// How far a place inside or outside of the room is from what bounds the first dimensions of it.
double distance_to_walls(const double *place, int dimensions) {
    double inside = 1e9, outside = 0;
    for (int n = 0; n < dimensions; n++) {
        double depth = std::min(place[n] - LOW[n], HIGH[n] - place[n]);
        inside = std::min(inside, depth);
        outside = std::max(outside, -depth);
    }
    return outside > 0 ? outside : inside;
}

int main(int, char **arguments) {
    DomainParticipantQos qos = PARTICIPANT_QOS_DEFAULT;
    auto loopback = std::make_shared<eprosima::fastdds::rtps::UDPv4TransportDescriptor>();
    loopback->interfaceWhiteList.push_back("127.0.0.1");
    qos.transport().use_builtin_transports = false;
    qos.transport().user_transports.push_back(loopback);
    DomainParticipant *participant = DomainParticipantFactory::get_instance()->create_participant(std::atoi(arguments[1]), qos);
    DataWriter *fixed = writer<tf2_msgs::msg::dds_::TFMessage_PubSubType>(participant, "rt/tf_static", true, true);
    DataWriter *points = writer<sensor_msgs::msg::dds_::PointCloud2_PubSubType>(participant, "rt/points", false, false);
    DataWriter *odometry = writer<nav_msgs::msg::dds_::Odometry_PubSubType>(participant, "rt/odom", false, true);
    DataReader *transforms = reader<tf2_msgs::msg::dds_::TFMessage_PubSubType>(participant, "rt/tf", false);
    DataReader *grids = reader<nav_msgs::msg::dds_::OccupancyGrid_PubSubType>(participant, "rt/mapper/grid", true);
    DataReader *surfaces = reader<sensor_msgs::msg::dds_::PointCloud2_PubSubType>(participant, "rt/mapper/surface_points", false);

    TFMessage_ mounts;
    TransformStamped_ mount;
    mount.header(header(0, "base_link"));
    mount.child_frame_id("lidar");
    mount.transform().translation().z(LIDAR);
    mount.transform().rotation().w(1);
    mounts.transforms().push_back(mount);
    fixed->write(&mounts);
    int from_map = 0, occupied = 0, occupied_off = 0, free_cells = 0, free_outside = 0, vertices = 0, vertices_off = 0;
    auto begin = std::chrono::steady_clock::now();
    for (int step = 0; from_map < 50 || occupied < 300 || vertices < 10000; step++) {
        double t = 0.02 * step, yaw = 0.2 * t, x = 1.5 * std::sin(yaw), y = 1.5 - 1.5 * std::cos(yaw);
        double now = std::chrono::duration<double>(std::chrono::system_clock::now().time_since_epoch()).count();
        Odometry_ pose;
        pose.header(header(now, "odom"));
        pose.child_frame_id("base_link");
        pose.pose().pose().position().x(x);
        pose.pose().pose().position().y(y);
        pose.pose().pose().orientation().z(std::sin(yaw / 2));
        pose.pose().pose().orientation().w(std::cos(yaw / 2));
        odometry->write(&pose);
        if (step % 5 == 0) {
            PointCloud2_ seen = cloud(now, x, y, yaw);
            points->write(&seen);
        }
        take<TFMessage_>(transforms, [&](TFMessage_ &message) {
            for (auto &transform : message.transforms()) from_map += transform.header().frame_id() == "map";
        });
        take<OccupancyGrid_>(grids, [&](OccupancyGrid_ &grid) {
            occupied = occupied_off = free_cells = free_outside = 0;
            for (uint32_t k = 0; k < grid.data().size(); k++) {
                double edge = grid.info().resolution(), column = k % grid.info().width(), row = k / grid.info().width();
                double place[2] = {grid.info().origin().position().x() + (column + 0.5) * edge, grid.info().origin().position().y() + (row + 0.5) * edge};
                bool is_outside = std::abs(place[0]) > HIGH[0] || std::abs(place[1]) > HIGH[1];
                int8_t value = static_cast<int8_t>(grid.data()[k]);
                occupied += value == 100;
                occupied_off += value == 100 && distance_to_walls(place, 2) > 2 * edge;
                free_cells += value == 0;
                free_outside += value == 0 && is_outside;
            }
        });
        take<PointCloud2_>(surfaces, [&](PointCloud2_ &surface) {
            for (uint32_t k = 0; k < surface.width() * surface.height(); k++) {
                float p[3];
                std::memcpy(p, surface.data().data() + k * surface.point_step(), sizeof p);
                double place[3] = {p[0], p[1], p[2]};
                vertices++;
                vertices_off += distance_to_walls(place, 3) > 0.05;
            }
        });
        std::this_thread::sleep_until(begin + std::chrono::milliseconds(20 * (step + 1)));
    }
    std::printf("{\"from_map\": %d, \"occupied\": %d, \"occupied_off\": %d, \"free\": %d, \"free_outside\": %d, \"vertices\": %d, \"vertices_off\": %d}\n", from_map, occupied, occupied_off,
                free_cells, free_outside, vertices, vertices_off);
}
