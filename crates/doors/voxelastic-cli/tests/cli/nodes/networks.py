"""Networks of ROS 2 as the robots beside this use them: `join("7")` is domain 7 of Cyclone DDS, `join("tcp/127.0.0.1:PORT")` a Zenoh network whose router, at PORT, is this program. Messages
are those of dds_types in both: written by Cyclone's own encoder, which is that of ROS 2."""
import json
import time

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE = 120.0
#: As a client of rmw_cyclonedds says whose a request is.
CLIENT = 77


class Cyclone:
    def __init__(self, domain):
        self.participant, self.number, self.clients = DomainParticipant(domain), 0, {}
        reliable, volatile = Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.Volatile
        self.profiles = {
            "latched": Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepLast(1)),
            "usual": Qos(reliable, volatile, Policy.History.KeepLast(200)),
            "sensor": Qos(Policy.Reliability.BestEffort, volatile, Policy.History.KeepLast(5)),
        }

    def _writer(self, name, kind, profile):
        return DataWriter(self.participant, Topic(self.participant, name, kind), qos=self.profiles[profile])

    def _reader(self, name, kind, profile):
        return DataReader(self.participant, Topic(self.participant, name, kind), qos=self.profiles[profile])

    def writer(self, name, kind, profile="usual"):
        writer = self._writer(f"rt/{name}", kind, profile)
        writer.is_heard = lambda: bool(writer.get_matched_subscriptions())
        writer.wait = lambda: writer.wait_for_acks(duration(seconds=PATIENCE))
        return writer

    def reader(self, name, kind, profile="usual"):
        return CycloneReader(self._reader(f"rt/{name}", kind, profile))

    def call(self, service, request, response, *arguments):
        """As rmw_cyclonedds does, by a client that is kept; asked again until it is heard."""
        if service not in self.clients:
            self.clients[service] = self._writer(f"rq/{service}Request", request, "usual"), self._reader(f"rr/{service}Reply", response, "usual")
        asks, answers = self.clients[service]
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            matched = time.monotonic() + 5.0
            while not (asks.get_matched_subscriptions() and answers.get_matched_publications()) and time.monotonic() < matched:
                time.sleep(0.02)
            self.number += 1
            asks.write(request(CLIENT, self.number, *arguments))
            wait = time.monotonic() + 10.0
            while time.monotonic() < wait:
                for answer in answers.take(N=10):
                    if (answer.client, answer.number) == (CLIENT, self.number):
                        return answer
                time.sleep(0.01)
        raise SystemExit(f"no answer of {service}")


class CycloneReader:
    def __init__(self, reader):
        self.reader = reader

    def take(self):
        """What came since the last time: when it was sent, ns, and the message."""
        messages = self.reader.take(N=200)
        return [(message.sample_info.source_timestamp, message) for message in messages if message.sample_info.valid_data]


class Zenoh:
    """As rmw_zenoh: keys with the hashes of types, tokens for what there is, what is latched from a publisher's cache."""

    def __init__(self, locator):
        import zenoh

        from type_hashes import hash_of

        config = zenoh.Config()
        for name, value in {"mode": '"router"', "scouting/multicast/enabled": "false", "timestamping/enabled": "true", "listen/endpoints": json.dumps([locator])}.items():
            config.insert_json5(name, value)
        self.zenoh, self.session, self.hash_of, self.tokens, self.number = zenoh, zenoh.open(config), hash_of, [], 0

    def key(self, name, kind):
        package, folder, _, base = kind.__idl_typename__.replace(".", "::").split("::")
        base = base.removesuffix("_")
        if folder == "srv":
            base = base.removesuffix("_Request")
        return f"0/{name}/{package}::{folder}::dds_::{base}_/{self.hash_of(f'{package}/{folder}/{base}')}"

    def announce(self, role, name, kind):
        _, typename, type_hash = self.key(name, kind).rsplit("/", 2)
        number = len(self.tokens)
        token = f"@ros2_lv/0/{self.session.zid()}/0/{number}/{role}/%/%/robot/%{name.replace('/', '%')}/{typename}/{type_hash}/::,10:,:,:,,"
        self.tokens.append(self.session.liveliness().declare_token(token))

    def attachment(self):
        self.number += 1
        return self.number.to_bytes(8, "little") + time.time_ns().to_bytes(8, "little") + bytes([16]) + bytes(16)

    def writer(self, name, kind, profile="usual"):
        self.announce("MP", name, kind)
        return ZenohWriter(self, self.key(name, kind), profile == "latched")

    def reader(self, name, kind, profile="usual"):
        reader = ZenohReader(self, self.key(name, kind), kind, profile == "latched")
        self.announce("MS", name, kind)
        return reader

    def call(self, service, request, response, *arguments):
        # Whose a request is stands beside it here: what Cyclone's clients begin with, two numbers, is left out.
        asked = request(CLIENT, 0, *arguments).serialize()
        until = time.monotonic() + PATIENCE
        while time.monotonic() < until:
            for reply in self.session.get(self.key(service, request), payload=asked[:4] + asked[20:], attachment=self.attachment(), timeout=60):
                if reply.ok is not None:
                    answer = bytes(reply.ok.payload)
                    return response.deserialize(answer[:4] + bytes(16) + answer[4:])
            time.sleep(0.1)
        raise SystemExit(f"no answer of {service}")


class ZenohWriter:
    def __init__(self, network, key, is_latched):
        self.network = network
        if is_latched:
            cache = network.zenoh.ext.CacheConfig(max_samples=1)
            self.publisher = network.zenoh.ext.declare_advanced_publisher(network.session, key, cache=cache, publisher_detection=True)
        else:
            self.publisher = network.session.declare_publisher(key)

    def write(self, message):
        self.publisher.put(message.serialize(), attachment=self.network.attachment())

    def is_heard(self):
        return self.publisher.matching_status.matching

    def wait(self):
        """Who is sent to on a link that loses nothing needs not be waited for, but for what is on the way."""
        time.sleep(0.5)


class ZenohReader:
    def __init__(self, network, key, kind, is_latched):
        # A queue: threads that call functions of this program would keep it from ending.
        self.kind, queue, ext = kind, network.zenoh.handlers.FifoChannel(10_000), network.zenoh.ext
        if is_latched:
            history = ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            self.subscriber = ext.declare_advanced_subscriber(network.session, key, queue, history=history)
        else:
            self.subscriber = network.session.declare_subscriber(key, queue)

    def take(self):
        came = iter(self.subscriber.try_recv, None)
        return [(int.from_bytes(bytes(sample.attachment)[8:16], "little"), self.kind.deserialize(bytes(sample.payload))) for sample in came]


def join(place):
    return Cyclone(int(place)) if place.isdigit() else Zenoh(place)
