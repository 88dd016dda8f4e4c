//! Where an Ouster sensor is, or where its packets come to.

use crate::failure::Failure;
use std::net::{IpAddr, ToSocketAddrs};
use std::path::Path;
use voxelastic_io::ouster::SensorMetadata;
use voxelastic_live::ouster::ask_metadata;

/// The port to which sensors send the packets of the lidar, unless they are told otherwise.
pub const LIDAR_PORT: u16 = 7502;

/// A sensor's name or address, or a port of this machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum OusterAddress {
    /// A sensor, which is asked what it is; only its packets are taken.
    Sensor(String),
    /// A port to which somebody sends packets.
    Port(u16),
}

impl OusterAddress {
    /// Parses the argument.
    pub fn parse(text: &str) -> Result<Self, String> {
        match text.parse() {
            Ok(port) if port > 0 => Ok(Self::Port(port)),
            Ok(_) => Err("a port is 1 to 65535".to_owned()),
            Err(_) if text.is_empty() || text.contains(char::is_whitespace) => Err("must be a sensor's name or address, or a port".to_owned()),
            Err(_) => Ok(Self::Sensor(text.to_owned())),
        }
    }

    /// The port, if it was given.
    pub fn port(&self) -> Option<u16> {
        if let Self::Port(port) = self { Some(*port) } else { None }
    }

    /// The address of the sensor, if it is known.
    pub fn host(&self) -> Option<IpAddr> {
        let Self::Sensor(host) = self else { return None };
        let name = host.rsplit_once(':').filter(|(_, port)| port.parse::<u16>().is_ok()).map_or(host.as_str(), |(name, _)| name);
        (name, 0).to_socket_addrs().ok()?.next().map(|address| address.ip())
    }

    /// What the sensor is: from a file, else it is asked.
    pub fn metadata(&self, file: Option<&Path>) -> anyhow::Result<SensorMetadata> {
        match (file, self) {
            (Some(file), _) => Ok(SensorMetadata::read(file)?),
            (None, Self::Sensor(host)) => {
                let remedy = "check its address; or save its description as a file, and name it with --metadata";
                let answer = ask_metadata(host)
                    .map_err(|problem| Failure::new(format!("{host}: the sensor cannot be asked what it is: {problem}"), remedy))?;
                Ok(SensorMetadata::parse(&answer, Path::new(host))?)
            }
            (None, Self::Port(port)) => {
                let remedy = "name the sensor's description with --metadata, or give the sensor's address instead of a port";
                Err(Failure::usage(format!("--ouster {port} does not say what sensor it is"), remedy).into())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sensors_and_ports_are_told_apart() {
        let sensor = |text: &str| Ok(OusterAddress::Sensor(text.to_owned()));
        assert_eq!(OusterAddress::parse("7502"), Ok(OusterAddress::Port(7502)));
        assert_eq!(OusterAddress::parse("os-122.local"), sensor("os-122.local"));
        assert!(["", "0", "a b"].iter().all(|text| OusterAddress::parse(text).is_err()));
        assert_eq!(OusterAddress::parse("127.0.0.1:8080").unwrap().host(), Some(IpAddr::from([127, 0, 0, 1])));
        assert_eq!(OusterAddress::Port(1).host(), None);
    }
}
